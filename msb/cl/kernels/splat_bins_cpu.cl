// Tile lists in CPU style, by a counting sort by tile.
// Each work-item takes a contiguous chunk of primitives in depth order.

#include "lanes.cl"
#include "splat_compact.cl"

#define AHEAD 32 // number of primitives to prefetch ahead, because their tiles are scattered in memory

// Most primitives reach at most 2 x 2 tiles.
// Four steps without branches are faster than loops of unpredictable length.
#define IS_SMALL(b) ((b).z - (b).x <= 2 && (b).w - (b).y <= 2)

// The array `counts` is chunk-major, so chunks never write to the same cache line.
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
        PREFETCH_FAR(tiles + order[i + AHEAD < to ? i + AHEAD : i]);
        Tiles b = tiles[order[i]];
        ordered_tiles[i] = b; // the next pass reads the array in order
        if (IS_SMALL(b)) {
            uint wide = b.z - b.x - 1u, tall = b.w - b.y - 1u;
            __global uint *first = mine + b.y * columns + b.x, *below = first + tall * columns;
            first[0]++;
            first[wide] += wide;
            below[0] += tall;
            below[wide] += wide & tall;
            continue;
        }
        for (uint y = b.y; y < b.w; y++)
            for (uint x = b.x; x < b.z; x++)
                mine[y * columns + x]++;
    }
}

// Replaces each count by the position of the chunk in the list of the tile.
// The totals are the lengths of the lists.
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
#define PUT(tile, more)                                                                                      \
    do {                                                                                                     \
        uint t = tile;                                                                                       \
        list[starts[t] + mine[t]] = place;                                                                   \
        mine[t] += more;                                                                                     \
    } while (0)
    for (size_t i = from; i < to; i++) {
        uint place = order[i];
        Tiles b = ordered_tiles[i];
        uint corner = b.y * columns + b.x;
        if (IS_SMALL(b)) {
            // If a primitive has only one column or row of tiles, some writes repeat the entry of its first
            // tile.
            uint wide = b.z - b.x - 1u, tall = b.w - b.y - 1u, below = corner + tall * columns;
            PUT(wide & tall ? below + 1 : corner, wide & tall);
            PUT(below, tall);
            PUT(corner + wide, wide);
            PUT(corner, 1);
            continue;
        }
        for (uint y = b.y; y < b.w; y++, corner += columns)
            for (uint x = 0; x < (uint)(b.z - b.x); x++)
                PUT(corner + x, 1);
    }
#undef PUT
}
