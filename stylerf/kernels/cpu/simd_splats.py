"""A row of a tile's pixels as one vector, in LLVM IR: composite a Gaussian to it, or sum its gradients.

numba does not vectorize these loops, because they branch and call an exponential (one thread, a view of 400x400 pixels
and 300,000 Gaussians: 285 ms scalar, 80 ms vectorized; 700 and 150 ms for the gradients).
"""

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from stylerf.kernels.cpu.simd_vm import INDEX, SCALAR, Rows, data_pointer

TILE = 8  # pixels; one row is one vector
PIXELS = TILE * TILE
LARGEST_ALPHA = 0.99
SMALLEST_ALPHA = 1 / 255
LEAST_TRANSMITTANCE = 1e-4
PAIR = 9  # sums over pixels: of dL/d(power) and its moments x, y, xx, xy, yy; dL/d(red, green, blue)


class _Row:
    """Arithmetic on vectors of TILE floats."""

    def __init__(self, builder: ir.IRBuilder) -> None:
        self.rows = Rows(builder, TILE)
        self.builder = builder

    def constant(self, value: float):
        return ir.Constant(self.rows.type, [value] * TILE)

    def smaller(self, a, b):
        return self.builder.select(self.builder.fcmp_ordered("<", a, b), a, b)

    def exponential(self, x):
        """exp(x) for -9 <= x <= 0, to within 4e-6; exp(-9) below. Series of exp(x / 16), repeatedly squared."""
        least = self.constant(-9.0)
        x = self.builder.select(self.builder.fcmp_ordered("<", x, least), least, x)
        y = self.rows.mul(x, self.constant(1 / 16))
        e = self.constant(1 / 720)
        for coefficient in (1 / 120, 1 / 24, 1 / 6, 1 / 2, 1.0, 1.0):
            e = self.rows.fused(e, y, self.constant(coefficient))
        for _ in range(4):
            e = self.rows.mul(e, e)
        return e

    def alpha(self, mx, constant, slope, half_a, opacity):
        """Return dx [TILE], and alpha before and after clamping to its maximum."""
        rows = self.rows
        lanes = ir.Constant(rows.type, [float(lane) for lane in range(TILE)])
        dx = rows.sub(lanes, rows.splat(mx))
        # -(a dx^2 + c dy^2) / 2 - b dx dy
        inner = rows.fused(rows.splat(half_a), dx, rows.splat(slope))
        power = rows.sub(rows.splat(constant), rows.mul(dx, inner))
        whole = rows.mul(rows.splat(opacity), self.exponential(power))
        return dx, whole, self.smaller(whole, self.constant(LARGEST_ALPHA))

    def weight(self, alpha, left):
        """Return the Gaussian's weight: left * alpha, or 0 where alpha or the transmittance `left` is too small."""
        b = self.builder
        counts = b.and_(
            b.fcmp_ordered(">=", alpha, self.constant(SMALLEST_ALPHA)),
            b.fcmp_ordered(">=", left, self.constant(LEAST_TRANSMITTANCE)),
        )
        return b.select(counts, self.rows.mul(left, alpha), self.constant(0.0)), counts


def _offset(builder, at, count: int):
    return builder.add(at, ir.Constant(at.type, count))


@intrinsic
def blend_row(typing, planes, at, mx, constant, slope, half_a, opacity, red, green, blue):
    """Composite a Gaussian to the row at `at` of planes [4, PIXELS] (flat): red, green, blue, transmittance."""

    def generate(context, builder, sig, args):
        row, pointer, at = _Row(builder), data_pointer(context, builder, sig.args[0], args[0]), args[1]
        rows = row.rows
        _, _, alpha = row.alpha(*args[2:7])
        left_at = _offset(builder, at, 3 * PIXELS)
        left = rows.load(pointer, left_at)
        weight, _ = row.weight(alpha, left)
        for channel, color in enumerate(args[7:10]):
            rows.add_product(pointer, _offset(builder, at, channel * PIXELS), weight, rows.splat(color))
        rows.store(pointer, left_at, rows.sub(left, weight))
        return context.get_dummy_value()

    return types.void(planes, INDEX, *[SCALAR] * 8), generate


@intrinsic
def blend_row_backward(typing, planes, at, dy, mx, constant, slope, half_a, opacity, red, green, blue):
    """Add a Gaussian's gradients for the row at `at` to the sums [PAIR, TILE] after planes [6, PIXELS] (flat).

    The planes: dL/d(red, green, blue, alpha), transmittance, and the sum of w D behind it, D = g . (color, 1).
    """

    def generate(context, builder, sig, args):
        row, pointer, at = _Row(builder), data_pointer(context, builder, sig.args[0], args[0]), args[1]
        rows = row.rows
        dy = rows.splat(args[2])
        dx, whole, alpha = row.alpha(*args[3:8])
        left_at, behind_at = _offset(builder, at, 4 * PIXELS), _offset(builder, at, 5 * PIXELS)
        left, behind = rows.load(pointer, left_at), rows.load(pointer, behind_at)
        weight, counts = row.weight(alpha, left)
        g = [rows.load(pointer, _offset(builder, at, channel * PIXELS)) for channel in range(4)]
        d = g[3]
        for gradient, color in zip(g, args[8:11]):
            d = rows.fused(gradient, rows.splat(color), d)
        behind = rows.sub(behind, rows.mul(weight, d))
        rows.store(pointer, left_at, rows.sub(left, weight))
        rows.store(pointer, behind_at, behind)
        passed = rows.sub(row.constant(1.0), alpha)
        slant = rows.sub(rows.mul(left, d), builder.fdiv(behind, passed))
        free = builder.and_(counts, builder.fcmp_ordered("<", whole, row.constant(LARGEST_ALPHA)))
        power = builder.select(free, rows.mul(slant, alpha), row.constant(0.0))
        across, down = rows.mul(power, dx), rows.mul(power, dy)
        terms = [power, across, down, rows.mul(across, dx), rows.mul(across, dy), rows.mul(down, dy)]
        terms += [rows.mul(weight, gradient) for gradient in g[:3]]
        for k, term in enumerate(terms):
            rows.add_to(pointer, ir.Constant(at.type, 6 * PIXELS + k * TILE), term)
        return context.get_dummy_value()

    return types.void(planes, INDEX, *[SCALAR] * 9), generate


@intrinsic
def row_total(typing, planes, at):
    """Return the sum of the TILE floats at `at`."""

    def generate(context, builder, sig, args):
        rows = Rows(builder, TILE)
        return rows.total(rows.load(data_pointer(context, builder, sig.args[0], args[0]), args[1]))

    return types.float32(planes, INDEX), generate
