"""Executors that run work in this process, in other processes of this machine, or on a cluster.

In: a function and its shards, which name the folders they read. Out: their results, in the order of the shards, wherever they ran.
Later packages register here only the folders that a process keeps open.
"""
