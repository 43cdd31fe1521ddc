"""Compiles every GPU kernel to machine code for GPUs that need not be there; one JSON line a kernel on stdout.

Arguments: a part of the kernels' names (empty: all), compute capabilities such as 80 and 90.

The launches are those of stylerf/kernels/gpu/launch.py on CPU tensors, recorded instead of run. A program of its own,
because Triton decides at its import whether it interprets.
"""

import json
import sys

import numpy as np
import torch
import triton
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource
from triton.runtime.jit import JITFunction

TYPES = {
    torch.float32: "fp32", torch.float16: "fp16", torch.int32: "i32", torch.int64: "i64", torch.uint8: "u8",
    torch.int16: "i16", torch.bool: "i1",
}  # fmt: skip
LAUNCHES: dict[str, tuple] = {}


def record(function, *arguments, grid=None, warmup=False, num_warps=4, num_stages=3, **named) -> None:
    """In place of JITFunction.run."""
    bound = dict(zip(function.arg_names, arguments)) | named
    constants = {n: bound[n] for n, p in zip(function.arg_names, function.params) if p.is_constexpr}
    signature, attributes = {}, {}
    for place, (name, parameter) in enumerate(zip(function.arg_names, function.params)):
        value = bound[name]
        if parameter.is_constexpr:
            signature[name] = "constexpr"
        elif isinstance(value, torch.Tensor):
            signature[name] = "*" + TYPES[value.dtype]
            if not parameter.do_not_specialize_on_alignment and value.data_ptr() % 16 == 0:
                attributes[(place,)] = [["tt.divisibility", 16]]
        else:
            whole = "i32" if isinstance(value, int) and abs(value) < 2**31 else "i64"
            signature[name] = "fp32" if isinstance(value, float) else whole
    name = f"{function.__module__.rsplit('.', 1)[-1]}.{function.__name__}"
    key = f"{name} {sorted(constants.items())} {sorted(signature.items())}"
    LAUNCHES[key] = (function, signature, constants, attributes, {"num_warps": num_warps, "num_stages": num_stages})


def main() -> None:
    JITFunction.run = record
    from tests.stylerf.kernels.gpu import launches

    torch.manual_seed(0)
    np.random.seed(0)
    launches.everything()
    wanted, *capabilities = sys.argv[1:]
    for key, (function, signature, constants, attributes, options) in LAUNCHES.items():
        if wanted not in key.split(" ")[0]:
            continue
        for capability in map(int, capabilities):
            source = ASTSource(function, signature, constants, attributes)
            made = triton.compile(source, target=GPUTarget("cuda", capability, 32), options=options)
            row = {
                "kernel": key.split(" ")[0], "constants": {k: str(v) for k, v in constants.items()},
                "capability": capability, "shared": made.metadata.shared, "cubin": len(made.asm["cubin"]),
            }  # fmt: skip
            print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
