"""Panels, operators and the command line.

In: what a person asks for. Out: a BakeRequest, and words about its progress.
"""
