"""numba kernels: multithreaded, with exact backward passes, bit-reproducible for a given number of threads.

Rays are split into one contiguous partition per thread. Each thread accumulates gradients in its own buffer, and the
optimizer sums the buffers in order, so no result depends on which thread finishes first.
"""
