"""The whole bake: stages, rounds of photons, stop rules, state that is kept.

In: a job's folder. Out: image files, a result and messages. The only package that knows all others.
"""
