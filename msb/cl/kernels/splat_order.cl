// In which order the faces of a model lie on the device, decided once for each asset: by size, and among faces of
// about the same size along a Z-order curve through their centroids. So what a view keeps lies together, in
// memory and on the screen: lines and pages that are fetched are used whole, and groups of faces are dropped as
// one.
//
// Source of the curve: G. M. Morton, A computer oriented geodetic data base (1966).

#define AXIS_BITS 18 // three make 54 bits; below them there is room for an exponent
#define CELLS ((float)(1 << AXIS_BITS))

// Bit b of 18 goes to bit 3 b.
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

// bounds: of bound_faces (splat_bounds.cl); low: the least coordinates there are.
__kernel void order_keys(__global const float *bounds, __global ulong *keys, uint stride, uint count,
                         float low_x, float low_y, float low_z, float cells_per_unit)
{
    size_t i = get_global_id(0);
    if (i >= count)
        return;
    ulong x = spread(cell_of(bounds[i], low_x, cells_per_unit));
    ulong y = spread(cell_of(bounds[i + stride], low_y, cells_per_unit));
    ulong z = spread(cell_of(bounds[i + 2 * (size_t)stride], low_z, cells_per_unit));
    // The inradius, whose power of two is the size.
    uint size = (as_uint(bounds[i + 3 * (size_t)stride]) & 0xffff) >> 7;
    keys[i] = (ulong)size << 3 * AXIS_BITS | x | y << 1 | z << 2;
}
