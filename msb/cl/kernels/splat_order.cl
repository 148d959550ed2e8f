// Sorts the faces of a model, or the vertices of a mesh, on the device: along a Z-order curve through space.
// In a triangle soup, faces are first sorted by size.
// Faces of about the same size are sorted along the curve.
// Faces that are kept in a view are then close in memory and on the screen.
// Fetched cache lines and pages are used completely, and groups of faces are dropped together.
//
// The curve is from G. M. Morton, A computer oriented geodetic data base (1966).

// msb/render/splat/order.py defines AXIS_BITS.
#define CELLS ((float)(1 << AXIS_BITS))

// Moves bit b of 18 bits to bit 3 b.
ulong spread(uint cell)
{
    ulong bits = cell;
    bits = (bits | bits << 32) & 0x000300000000ffffUL;
    bits = (bits | bits << 16) & 0x00030000ff0000ffUL;
    bits = (bits | bits << 8) & 0x000300f00f00f00fUL;
    bits = (bits | bits << 4) & 0x00030c30c30c30c3UL;
    return (bits | bits << 2) & 0x0009249249249249UL;
}

uint cell_of(float x, float low, float cells_per_unit)
{
    float cell = (x - low) * cells_per_unit;
    return cell > 0.0f ? (uint)(cell < CELLS - 1.0f ? cell : CELLS - 1.0f) : 0; // NaN: 0
}

// `bounds` comes from bound_faces (splat_bounds.cl); its last row is read only if `by_size` is set. low: the
// lowest coordinates.
__kernel void order_keys(__global const float *bounds, __global ulong *keys, uint stride, uint count,
                         float low_x, float low_y, float low_z, float cells_per_unit, uint by_size)
{
    size_t i = get_global_id(0);
    if (i >= count)
        return;
    ulong x = spread(cell_of(bounds[i], low_x, cells_per_unit));
    ulong y = spread(cell_of(bounds[i + stride], low_y, cells_per_unit));
    ulong z = spread(cell_of(bounds[i + 2 * (size_t)stride], low_z, cells_per_unit));
    keys[i] = x | y << 1 | z << 2;
    if (by_size) // the binary exponent of the inradius
        keys[i] |= (ulong)((((__global const uint *)bounds)[i + 3 * (size_t)stride] & 0xffff) >> 7) << 3 * AXIS_BITS;
}
