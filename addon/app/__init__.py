"""One bake from request to result: the child process, its messages, and the state of the panel's bakes.

In: a BakeRequest. Out: a Session whose pages are shown, and a report.
"""
