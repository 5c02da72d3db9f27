"""A shared library of all kernels, with which processes need neither numba nor LLVM.

`murmur setup` builds it if this machine has a C compiler: `machine_code` lets numba compile each kernel to an object
file, `wrappers` writes C functions that convert Python objects, and `build` links both into an extension module.
`library` finds the module and loads it. A kernel is called from the library if its `digest` is there; otherwise
numba compiles it (`protocol.kernels`). The machine code comes from the same compiler with the same options, so
results are equal to the bit.
"""
