// Tile lists in GPU style: write pairs (tile, primitive) in depth order, then sort them stably by tile.

#include "splat_compact.cl"

__kernel void count_pairs(__global const uint *order, __global const Tiles *tiles, __global uint *counts,
                          uint count)
{
    size_t i = get_global_id(0);
    if (i >= count)
        return;
    Tiles b = tiles[order[i]];
    counts[i] = (uint)(b.z - b.x) * (uint)(b.w - b.y);
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

// starts[t] is the position of the first pair of tile t or a later tile.
// The last entry, starts[tile_count], is the number of pairs.
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
