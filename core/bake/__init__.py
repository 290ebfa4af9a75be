"""The whole bake: its stages, rounds of photons, stop rules, and the state from which it can continue.

In: a job's folder. Out: image files, a result and messages. The only package that imports all others.
"""
