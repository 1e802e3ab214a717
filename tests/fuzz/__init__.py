"""Inputs of chance, damaged and hostile, thrown at linkwise in processes that may die; `python -m fuzz` runs many.

A seed makes an input (`cases`), a worker runs it in a process of its own and says what came (`worker`), the pool sees to it
that a death or a hang is noticed (`pool`), and `checks` says what must never come.
"""
