"""Where work runs: in this process, in others of this machine, or on a cluster.

In: a function and its shards, which name the folders they read. Out: their results, in the order of the shards, whatever ran them.
Packages above register nothing here but the folders that a process keeps open.
"""
