"""Vector-width building blocks of the vm encoder, written in LLVM IR.

A vm sample touches four rows of `rank` floats per plane and two per line. numba's own loops over so few ranks spend
most of their time in alias checks and loop prologues (141 instead of 85 ns per sample for the backward at rank 8, 233
instead of 156 at rank 16), so these intrinsics load and store whole rows as vectors. The rank is a compile-time
constant: the length of the tuple `ranks`.

Fusion of multiplications and additions, and the order of sums over rows, are explicit here rather than left to the
compiler (decision 0007).
"""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

FLOAT = ir.FloatType()
INT32 = ir.IntType(32)
LINE = 16  # floats per cache line


class Rows:
    """Loads, stores and arithmetic of rows of `rank` floats at element offsets of a flat array."""

    def __init__(self, builder: ir.IRBuilder, rank: int) -> None:
        self.builder, self.rank, self.type = builder, rank, ir.VectorType(FLOAT, rank)

    def _address(self, pointer, offset):
        return self.builder.bitcast(self.builder.gep(pointer, [offset]), self.type.as_pointer())

    def load(self, pointer, offset):
        # Rows may start at any float: with a vector's default alignment, LLVM may emit loads that fault.
        row = self.builder.load(self._address(pointer, offset))
        row.align = 4
        return row

    def add_to(self, pointer, offset, row) -> None:
        self.store(pointer, offset, self.add(self.load(pointer, offset), row))

    def add_product(self, pointer, offset, a, b) -> None:
        """Add a * b to the stored row, fused (rounded once)."""
        self.store(pointer, offset, self.fused(a, b, self.load(pointer, offset)))

    def store(self, pointer, offset, row) -> None:
        stored = self.builder.store(row, self._address(pointer, offset))
        stored.align = 4

    def splat(self, scalar):
        undefined = ir.Constant(self.type, ir.Undefined)
        first = self.builder.insert_element(undefined, scalar, ir.Constant(INT32, 0))
        lanes = ir.Constant(ir.VectorType(INT32, self.rank), [0] * self.rank)
        return self.builder.shuffle_vector(first, undefined, lanes)

    def mul(self, a, b):
        return self.builder.fmul(a, b)

    def add(self, a, b):
        return self.builder.fadd(a, b)

    def sub(self, a, b):
        return self.builder.fsub(a, b)

    def fused(self, a, b, c):
        """Return a * b + c, fused (rounded once)."""
        name = f"llvm.fma.v{self.rank}f32"
        function = cgutils.get_or_insert_function(
            self.builder.module, ir.FunctionType(self.type, [self.type] * 3), name
        )
        return self.builder.call(function, [a, b, c])

    def total(self, row):
        """Return the sum of a row's elements; halves are added until their length is odd."""
        count, b = self.rank, self.builder
        # Adding halves shortens the dependency chain. The order affects the bits of the result (decision 0007).
        while count % 2 == 0:
            count //= 2
            low, high = (
                b.shuffle_vector(row, row, ir.Constant(ir.VectorType(INT32, count), list(range(at, at + count))))
                for at in (0, count)
            )
            row = b.fadd(low, high)
        terms = [b.extract_element(row, ir.Constant(INT32, k)) for k in range(count)]
        total = terms[0]
        for term in terms[1:]:
            total = b.fadd(total, term)
        return total

    def mix(self, weights, rows):
        """Return the sum of rows, each times a scalar."""
        result = self.mul(self.splat(weights[0]), rows[0])
        for weight, row in zip(weights[1:], rows[1:]):
            result = self.fused(self.splat(weight), row, result)
        return result


def data_pointer(context, builder, array_type, value):
    """Return a pointer to the first element of an array argument."""
    return context.make_array(array_type)(context, builder, value=value).data


def _weights(rows, fu, fv, fw):
    one = ir.Constant(FLOAT, 1.0)
    gu, gv, gw = rows.sub(one, fu), rows.sub(one, fv), rows.sub(one, fw)
    return [rows.mul(gu, gv), rows.mul(gu, fv), rows.mul(fu, gv), rows.mul(fu, fv)], [gw, fw]


class _Product:
    """One sample in one plane and its line: P = bilinear plane row, L = linear line row.

    The rows are in one flat table: the plane's at `first` and `second` (each with its right neighbor), the line's at
    `line` and the one after it.
    """

    def __init__(self, rows, table, first, second, line, fu, fv, fw) -> None:
        add, next_row = rows.builder.add, ir.Constant(first.type, rows.rank)
        self.rows = rows
        # At (u, v) = (0, 0), (0, 1), (1, 0), (1, 1).
        self.corners = [first, add(first, next_row), second, add(second, next_row)]
        self.ends = [line, add(line, next_row)]
        self.plane_weights, self.line_weights = _weights(rows, fu, fv, fw)
        self.plane = rows.mix(self.plane_weights, [rows.load(table, o) for o in self.corners])
        self.line = rows.mix(self.line_weights, [rows.load(table, o) for o in self.ends])

    def scatter(self, gradient, buffer) -> None:
        """Add gradient * dP and gradient * dL to the rows of `buffer`, laid out as the table."""
        # Product rule: d(P L) = L dP + P dL.
        plane, line = self.rows.mul(gradient, self.line), self.rows.mul(gradient, self.plane)
        for offset, weight in zip(self.ends, self.line_weights):
            self.rows.add_product(buffer, offset, self.rows.splat(weight), line)
        for offset, weight in zip(self.corners, self.plane_weights):
            self.rows.add_product(buffer, offset, self.rows.splat(weight), plane)


SCALAR, INDEX = types.float32, types.intp
_PLACE = (INDEX, INDEX, INDEX, SCALAR, SCALAR, SCALAR)  # first, second, line, fu, fv, fw


def _products(context, builder, rows, table, places):
    """Return one sample's three _Products. places: tuples of first, second, line, fu, fv, fw."""
    return [_Product(rows, table, *cgutils.unpack_tuple(builder, place)) for place in places]


def prefetch(builder, pointer, offset) -> None:
    """Prefetch the cache line that holds element `offset`."""
    byte = ir.IntType(8).as_pointer()
    kind = ir.FunctionType(ir.VoidType(), [byte, INT32, INT32, INT32])
    function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0i8")
    hints = [ir.Constant(INT32, hint) for hint in (0, 3, 1)]  # read access, nearest cache level, data
    builder.call(function, [builder.bitcast(builder.gep(pointer, [offset]), byte), *hints])


@intrinsic
def vm_prefetch(typing, table, at, place0, place1, place2, ranks):
    """Prefetch the rows of table[at:] that a sample needs while another one is being computed."""

    def generate(context, builder, sig, args):
        length = 2 * sig.args[-1].count  # two rows are adjacent
        table_at = builder.gep(data_pointer(context, builder, sig.args[0], args[0]), [args[1]])
        for place in args[2:5]:
            for begin in cgutils.unpack_tuple(builder, place)[:3]:
                # Rows are not aligned to cache lines: their last float can be in one more.
                for step in (*range(0, length - 1, LINE), length - 1):
                    prefetch(builder, table_at, builder.add(begin, ir.Constant(begin.type, step)))
        return context.get_dummy_value()

    return types.void(table, INDEX, place0, place1, place2, ranks), generate


@intrinsic
def vm_sum(typing, table, place0, place1, place2, ranks):
    """sum_m sum_r P_mr L_mr of one sample. place: (first, second, line, fu, fv, fw) of a plane, f: float32 position
    inside the cell, 0..1."""

    def generate(context, builder, sig, args):
        rows = Rows(builder, sig.args[-1].count)
        table_at = data_pointer(context, builder, sig.args[0], args[0])
        first, *others = _products(context, builder, rows, table_at, args[1:4])
        total = rows.mul(first.plane, first.line)
        for product in others:
            total = rows.fused(product.plane, product.line, total)
        return rows.total(total)

    return types.float32(table, place0, place1, place2, ranks), generate


@intrinsic
def vm_features(typing, table, first, second, line, fu, fv, fw, out, at, ranks):
    """out[at + r] = P_r L_r."""

    def generate(context, builder, sig, args):
        rows = Rows(builder, sig.args[-1].count)
        product = _Product(rows, data_pointer(context, builder, sig.args[0], args[0]), *args[1:7])
        rows.store(data_pointer(context, builder, sig.args[7], args[7]), args[8], rows.mul(product.plane, product.line))
        return context.get_dummy_value()

    return types.void(table, *_PLACE, out, INDEX, ranks), generate


def _head(rows, heads, j, m):
    """Return heads[(3 j + m) rank :], the weights of output j for the features of plane m."""
    return rows.load(heads, ir.Constant(ir.IntType(64), (3 * j + m) * rows.rank))


@intrinsic
def vm_projected(typing, table, place0, place1, place2, heads, out, ranks):
    """out[j] = sum_m sum_r heads[(3 j + m) rank + r] P_mr L_mr for j = 0, 1, 2; places as in vm_sum."""

    def generate(context, builder, sig, args):
        rows = Rows(builder, sig.args[-1].count)
        table_at, heads_at, out_at = (data_pointer(context, builder, sig.args[i], args[i]) for i in (0, 4, 5))
        sums = [None, None, None]
        for m, product in enumerate(_products(context, builder, rows, table_at, args[1:4])):
            feature = rows.mul(product.plane, product.line)
            for j, before in enumerate(sums):
                head = _head(rows, heads_at, j, m)
                sums[j] = rows.mul(feature, head) if before is None else rows.fused(feature, head, before)
        for j, row in enumerate(sums):
            builder.store(rows.total(row), builder.gep(out_at, [ir.Constant(INT32, j)]))
        return context.get_dummy_value()

    return types.void(table, place0, place1, place2, heads, out, ranks), generate


@intrinsic
def vm_projected_backward(typing, table, place0, place1, place2, heads, g0, g1, g2, head_gradients, buffer, at, ranks):
    """Add dL/d(heads) to head_gradients, and dL/d(table) to buffer[at:], from g = dL/d(out) of vm_projected."""

    def generate(context, builder, sig, args):
        rows = Rows(builder, sig.args[-1].count)
        pointers = (data_pointer(context, builder, sig.args[i], args[i]) for i in (0, 4, 8, 9))
        table_at, heads_at, head_gradients_at, buffer_at = pointers
        target, gradients = builder.gep(buffer_at, [args[10]]), [rows.splat(g) for g in args[5:8]]
        for m, product in enumerate(_products(context, builder, rows, table_at, args[1:4])):
            feature, to_feature = rows.mul(product.plane, product.line), None
            for j, gradient in enumerate(gradients):
                here = ir.Constant(ir.IntType(64), (3 * j + m) * rows.rank)
                rows.add_product(head_gradients_at, here, gradient, feature)
                head = _head(rows, heads_at, j, m)
                to_feature = rows.mul(gradient, head) if j == 0 else rows.fused(gradient, head, to_feature)
            product.scatter(to_feature, target)
        return context.get_dummy_value()

    arguments = table, place0, place1, place2, heads, SCALAR, SCALAR, SCALAR, head_gradients, buffer, INDEX, ranks
    return types.void(*arguments), generate


@intrinsic
def vm_dot_backward(typing, table, first, second, line, fu, fv, fw, gradient, buffer, at, ranks):
    """Add gradient * d(sum_r P_r L_r)/d(table) to buffer[at:], laid out as the table."""

    def generate(context, builder, sig, args):
        rows = Rows(builder, sig.args[-1].count)
        product = _Product(rows, data_pointer(context, builder, sig.args[0], args[0]), *args[1:7])
        target = builder.gep(data_pointer(context, builder, sig.args[8], args[8]), [args[9]])
        product.scatter(rows.splat(args[7]), target)
        return context.get_dummy_value()

    return types.void(table, *_PLACE, SCALAR, buffer, INDEX, ranks), generate


@intrinsic
def vm_features_backward(typing, table, first, second, line, fu, fv, fw, gradients, row, buffer, at, ranks):
    """vm_dot_backward with a separate gradient, gradients[row + r], for every rank."""

    def generate(context, builder, sig, args):
        rows = Rows(builder, sig.args[-1].count)
        product = _Product(rows, data_pointer(context, builder, sig.args[0], args[0]), *args[1:7])
        target = builder.gep(data_pointer(context, builder, sig.args[9], args[9]), [args[10]])
        product.scatter(rows.load(data_pointer(context, builder, sig.args[7], args[7]), args[8]), target)
        return context.get_dummy_value()

    return types.void(table, *_PLACE, gradients, INDEX, buffer, INDEX, ranks), generate


def _slopes(product, table, fu, fv):
    """Return the rows of d(P L) / d(fu, fv, fw)."""
    rows, one = product.rows, ir.Constant(FLOAT, 1.0)
    corners = [rows.load(table, o) for o in product.corners]
    ends = [rows.load(table, o) for o in product.ends]
    along_u = rows.mix([rows.sub(one, fv), fv], [rows.sub(corners[c + 2], corners[c]) for c in (0, 1)])
    along_v = rows.mix([rows.sub(one, fu), fu], [rows.sub(corners[c + 1], corners[c]) for c in (0, 2)])
    along_w = rows.sub(ends[1], ends[0])
    return [rows.mul(a, b) for a, b in ((along_u, product.line), (along_v, product.line), (along_w, product.plane))]


@intrinsic
def vm_slopes(typing, table, first, second, line, fu, fv, fw, out, ranks):
    """out[0:3] = d(sum_r P_r L_r) / d(fu, fv, fw)."""

    def generate(context, builder, sig, args):
        rows = Rows(builder, sig.args[-1].count)
        pointer = data_pointer(context, builder, sig.args[0], args[0])
        target = data_pointer(context, builder, sig.args[7], args[7])
        for axis, slope in enumerate(_slopes(_Product(rows, pointer, *args[1:7]), pointer, args[4], args[5])):
            builder.store(rows.total(slope), builder.gep(target, [ir.Constant(INT32, axis)]))
        return context.get_dummy_value()

    return types.void(table, *_PLACE, out, ranks), generate


@intrinsic
def vm_features_slopes(typing, table, first, second, line, fu, fv, fw, gradients, row, out, ranks):
    """vm_slopes for sum_r gradients[row + r] P_r L_r."""

    def generate(context, builder, sig, args):
        rows = Rows(builder, sig.args[-1].count)
        pointer = data_pointer(context, builder, sig.args[0], args[0])
        gradient = rows.load(data_pointer(context, builder, sig.args[7], args[7]), args[8])
        target = data_pointer(context, builder, sig.args[9], args[9])
        for axis, slope in enumerate(_slopes(_Product(rows, pointer, *args[1:7]), pointer, args[4], args[5])):
            builder.store(rows.total(rows.mul(gradient, slope)), builder.gep(target, [ir.Constant(INT32, axis)]))
        return context.get_dummy_value()

    return types.void(table, *_PLACE, gradients, INDEX, out, ranks), generate


@intrinsic
def axpy_row(typing, scale, source, source_at, to, to_at, ranks):
    """to[to_at + r] += scale * source[source_at + r]."""

    def generate(context, builder, sig, args):
        rows = Rows(builder, sig.args[-1].count)
        row = rows.load(data_pointer(context, builder, sig.args[1], args[1]), args[2])
        rows.add_product(data_pointer(context, builder, sig.args[3], args[3]), args[4], rows.splat(args[0]), row)
        return context.get_dummy_value()

    return types.void(SCALAR, source, INDEX, to, INDEX, ranks), generate


@intrinsic
def add_roughness(typing, table, here, above, below, left, right, strength, to, ranks):
    """to[here + r] += strength * sum over the four neighbors of table[here + r] - table[neighbor + r]."""

    def generate(context, builder, sig, args):
        rows = Rows(builder, sig.args[-1].count)
        table_at = data_pointer(context, builder, sig.args[0], args[0])
        own = rows.load(table_at, args[1])
        apart = [rows.sub(own, rows.load(table_at, neighbor)) for neighbor in args[2:6]]
        total = apart[0]
        for row in apart[1:]:
            total = rows.add(total, row)
        to_at = data_pointer(context, builder, sig.args[7], args[7])
        rows.add_product(to_at, args[1], rows.splat(args[6]), total)
        return context.get_dummy_value()

    return types.void(table, *[INDEX] * 5, SCALAR, to, ranks), generate


@intrinsic
def dot_rows(typing, a, a_at, b, b_at, ranks):
    """sum_r a[a_at + r] b[b_at + r]."""

    def generate(context, builder, sig, args):
        rows = Rows(builder, sig.args[-1].count)
        first = rows.load(data_pointer(context, builder, sig.args[0], args[0]), args[1])
        second = rows.load(data_pointer(context, builder, sig.args[2], args[2]), args[3])
        return rows.total(rows.mul(first, second))

    return types.float32(a, INDEX, b, INDEX, ranks), generate
