"""Compiled kernels of the semi-global matcher; import them only where they run, because numba takes long to import.

All arithmetic is cast explicitly: numba makes int64 of small integers, and uint64 of differences of unsigned ones. The
inner loops run over the disparities, touch few arrays and have no branch, so that the compiler makes vector code of
them; they see slices, because an index that may be negative prevents it. The kernels release the GIL and use no threads
of their own.
"""
