// One pass of a stable radix sort, GPU style: a work-group sorts a tile of GROUP * ITEMS keys by one digit
// in local memory, then writes runs of equal digits. Counting, prefix sum and a rank per work-item as in
// Satish, Harris and Garland, Designing efficient sorting algorithms for manycore GPUs (2009).
// KEY is uint or ulong. A pass sorts by the digit (key >> shift) & mask, mask < DIGITS.

#define SUM uint
#include "group_scan.cl"

#define TILE (GROUP * ITEMS)
#define DIGIT(key) ((uint)((key) >> shift) & mask)

// counts is digit-major, so that its exclusive prefix sum is where each tile writes each digit.
__kernel void count_digits(__global const KEY *keys, __global uint *counts, uint count, uint tiles,
                           uint shift, uint mask)
{
    __local uint mine[DIGITS];
    size_t tile = get_group_id(0), me = get_local_id(0);
    for (uint d = me; d < DIGITS; d += GROUP)
        mine[d] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint k = 0; k < ITEMS; k++) {
        size_t i = tile * TILE + k * GROUP + me;
        if (i < count)
            atomic_inc(&mine[DIGIT(keys[i])]);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint d = me; d <= mask; d += GROUP)
        counts[d * tiles + tile] = mine[d];
}

// With `number` the values are the element numbers, and values is not read.
__kernel void move_pairs(__global const KEY *restrict keys, __global const uint *restrict values,
                         __global KEY *restrict keys_out, __global uint *restrict values_out,
                         __global const uint *restrict places, uint count, uint tiles, uint shift,
                         uint mask, uint number)
{
    __local KEY staged[TILE];
    __local ushort ranks[DIGITS * GROUP]; // digit-major: digits in order, within a digit the work-items
    __local uint shared[GROUP];
    __local uint starts[DIGITS];
    size_t tile = get_group_id(0), me = get_local_id(0), base = tile * TILE;
    uint here = (uint)min((size_t)TILE, count - base); // keys in this tile

    // Consecutive keys belong to one work-item, which takes them in order: that makes the sort stable.
    uint rank[ITEMS], total, sum = 0;
    for (uint d = 0; d < DIGITS; d++)
        ranks[d * GROUP + me] = 0;
    for (uint k = 0; k < ITEMS; k++) {
        uint i = me * ITEMS + k;
        if (i < here)
            rank[k] = ranks[DIGIT(keys[base + i]) * GROUP + me]++;
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    // Prefix sum over all of `ranks`, DIGITS consecutive elements a work-item.
    for (uint d = 0; d < DIGITS; d++)
        sum += ranks[me * DIGITS + d];
    sum = group_scan(sum, shared, &total);
    for (uint d = 0; d < DIGITS; d++) {
        uint own = ranks[me * DIGITS + d];
        ranks[me * DIGITS + d] = (ushort)sum;
        sum += own;
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    for (uint d = me; d < DIGITS; d += GROUP)
        starts[d] = d <= mask ? places[d * tiles + tile] - ranks[d * GROUP] : 0;
    for (uint k = 0; k < ITEMS; k++) {
        uint i = me * ITEMS + k;
        if (i < here) {
            KEY key = keys[base + i];
            rank[k] += ranks[DIGIT(key) * GROUP + me];
            staged[rank[k]] = key;
        }
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    uint place[ITEMS];
    for (uint k = 0; k < ITEMS; k++) {
        uint i = k * GROUP + me;
        if (i < here) {
            KEY key = staged[i];
            place[k] = starts[DIGIT(key)] + i;
            keys_out[place[k]] = key;
        }
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    // The values take the same way through the same memory.
    for (uint k = 0; k < ITEMS; k++) {
        uint i = me * ITEMS + k;
        if (i < here)
            staged[rank[k]] = number ? (uint)(base + i) : values[base + i];
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint k = 0; k < ITEMS; k++) {
        uint i = k * GROUP + me;
        if (i < here)
            values_out[place[k]] = (uint)staged[i];
    }
}
