// From projected primitives to tile lists in depth order; the same for every method.
//
// Depth order comes first: N primitives are sorted, not N times their tiles. Appending them to tile lists in
// that order gives what the official kernels get by sorting (tile << 32 | depth) keys stably.

typedef ushort4 Tiles; // x0, y0, x1, y1: low inclusive, high exclusive

// places is the prefix sum of "is listed".
__kernel void compact(__global const uint *places, __global const uint *keys, __global uint *keys_out,
                      __global uint *numbers_out, uint count)
{
    size_t i = get_global_id(0);
    if (i < count && places[i + 1] != places[i]) {
        keys_out[places[i]] = keys[i];
        numbers_out[places[i]] = (uint)i;
    }
}

// ---- CPU style: a counting sort by tile; each work-item takes a contiguous chunk of the depth order

// counts is chunk-major: chunks never write to the same cache line.
__kernel void count_tiles(__global const uint *order, __global const Tiles *tiles,
                          __global Tiles *ordered_tiles, __global uint *counts, uint count,
                          uint chunk, uint columns, uint tile_count)
{
    size_t c = get_global_id(0);
    size_t from = min((size_t)count, c * chunk), to = min((size_t)count, from + chunk);
    __global uint *mine = counts + c * tile_count;
    for (uint t = 0; t < tile_count; t++)
        mine[t] = 0;
    for (size_t i = from; i < to; i++) {
        Tiles b = tiles[order[i]];
        ordered_tiles[i] = b; // so that the next pass reads them one after the other
        for (uint y = b.y; y < b.w; y++)
            for (uint x = b.x; x < b.z; x++)
                mine[y * columns + x]++;
    }
}

// counts become where in its tile's list each chunk begins; totals are the lengths of the lists.
__kernel void sum_tiles(__global uint *counts, __global uint *totals, uint chunks, uint tile_count)
{
    size_t t = get_global_id(0);
    if (t >= tile_count)
        return;
    uint sum = 0;
    for (size_t c = 0; c < chunks; c++) {
        uint here = counts[c * tile_count + t];
        counts[c * tile_count + t] = sum;
        sum += here;
    }
    totals[t] = sum;
}

__kernel void fill_tiles(__global const uint *order, __global const Tiles *ordered_tiles,
                         __global uint *counts, __global const ulong *starts, __global uint *list,
                         uint count, uint chunk, uint columns, uint tile_count)
{
    size_t c = get_global_id(0);
    size_t from = min((size_t)count, c * chunk), to = min((size_t)count, from + chunk);
    __global uint *mine = counts + c * tile_count;
    for (size_t i = from; i < to; i++) {
        uint number = order[i];
        Tiles b = ordered_tiles[i];
        for (uint y = b.y; y < b.w; y++)
            for (uint x = b.x; x < b.z; x++) {
                uint t = y * columns + x;
                list[starts[t] + mine[t]++] = number;
            }
    }
}

// ---- GPU style: pairs (tile, primitive) in depth order, then a stable sort by tile alone

__kernel void gather_counts(__global const uint *order, __global const uint *tile_counts,
                            __global uint *counts, uint count)
{
    size_t i = get_global_id(0);
    if (i < count)
        counts[i] = tile_counts[order[i]];
}

__kernel void emit_pairs(__global const uint *order, __global const Tiles *tiles,
                         __global const ulong *offsets, __global uint *pair_tiles,
                         __global uint *pair_numbers, uint count, uint columns)
{
    size_t i = get_global_id(0);
    if (i >= count)
        return;
    uint number = order[i];
    Tiles b = tiles[number];
    ulong place = offsets[i];
    for (uint y = b.y; y < b.w; y++)
        for (uint x = b.x; x < b.z; x++) {
            pair_tiles[place] = y * columns + x;
            pair_numbers[place++] = number;
        }
}

// starts[t] is the first pair of tile t or later, starts[tile_count] the number of pairs.
__kernel void find_starts(__global const uint *pair_tiles, __global ulong *starts, uint pairs,
                          uint tile_count)
{
    size_t i = get_global_id(0);
    if (i > pairs)
        return;
    uint from = i == 0 ? 0 : pair_tiles[i - 1] + 1;
    uint to = i == pairs ? tile_count : pair_tiles[i];
    for (uint t = from; t <= to; t++)
        starts[t] = i;
}
