"""numba kernels: all cores, exact backwards, bitwise reproducible for a given number of threads.

Rays are split into as many contiguous partitions as there are threads. Each thread adds gradients to a buffer of its
own, and the optimizer adds the buffers in order: no result depends on which thread finishes first.
"""
