"""Compiled kernels of the semi-global matcher; import them only where they run, because numba takes long to import.

All arithmetic is cast explicitly: numba makes int64 of small integers, and uint64 of differences of unsigned ones.
Loops over disparities are written in vectors; loops over columns touch few arrays and have no branch, so that the
compiler makes vector code of them. The kernels release the GIL and use no threads of their own.
"""
