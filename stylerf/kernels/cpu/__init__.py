"""numba kernels: all cores, exact backwards, bitwise reproducible for a given thread count.

Work is cut into as many contiguous chunks of rays as there are threads; each chunk adds its gradients to a buffer of
its own, and the optimizer adds the buffers in order. Nothing depends on which thread finishes first.
"""
