// One pass of a stable radix sort in GPU style.
// A work-group sorts a tile of GROUP * ITEMS keys by one digit in local memory, ROUND bits at a time.
// The work-group then writes runs of equal digits.
// Counting, prefix sum and rank follow Satish, Harris and Garland (2009).
// Title: Designing efficient sorting algorithms for manycore GPUs.
// The type KEY is uint or ulong.
// A pass sorts by the digit (key >> shift) & mask, where mask < DIGITS.

#define SUM uint
#include "group_scan.cl"

#define TILE (GROUP * ITEMS)
#define DIGIT(key) ((uint)((key) >> shift) & mask)
#define ROUND 4
#define PARTS (1 << ROUND) // number of values that ROUND bits can take
#define PART(key) (DIGIT(key) >> bit & (PARTS - 1))

// The array `counts` is digit-major.
// The exclusive prefix sum of `counts` gives the write position of each digit of each tile.
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

// If `number` is set, the values are element numbers, and `values` is not read.
__kernel void move_pairs(__global const KEY *restrict keys, __global const uint *restrict values,
                         __global KEY *restrict keys_out, __global uint *restrict values_out,
                         __global const uint *restrict places, uint count, uint tiles, uint shift,
                         uint mask, uint number)
{
    __local KEY sorted[TILE];
    __local ushort origin[TILE];         // original position in the tile of each key in `sorted`
    __local ushort ranks[PARTS * GROUP]; // ordered by part, then by work-item
    __local uint shared[GROUP];
    __local uint starts[DIGITS];
    size_t tile = get_group_id(0), me = get_local_id(0), base = tile * TILE;
    uint here = (uint)min((size_t)TILE, count - base); // number of keys in this tile

    for (uint k = 0; k < ITEMS; k++) { // adjacent work-items read adjacent keys
        uint i = k * GROUP + me;
        if (i < here) {
            sorted[i] = keys[base + i];
            origin[i] = (ushort)i;
        }
    }
    for (uint bit = 0; bit == 0 || mask >> bit; bit += ROUND) {
        // Each work-item takes consecutive keys in order, so the sort is stable.
        KEY mine[ITEMS];
        ushort from[ITEMS], rank[ITEMS];
        uint total, sum = 0;
        for (uint p = 0; p < PARTS; p++)
            ranks[p * GROUP + me] = 0;
        barrier(CLK_LOCAL_MEM_FENCE);
        for (uint k = 0; k < ITEMS; k++) {
            uint i = me * ITEMS + k;
            if (i < here) {
                mine[k] = sorted[i];
                from[k] = origin[i];
                rank[k] = ranks[PART(mine[k]) * GROUP + me]++;
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE);

        // Prefix sum over `ranks`, PARTS consecutive elements per work-item.
        for (uint p = 0; p < PARTS; p++)
            sum += ranks[me * PARTS + p];
        sum = group_scan(sum, shared, &total);
        for (uint p = 0; p < PARTS; p++) {
            uint rank_count = ranks[me * PARTS + p];
            ranks[me * PARTS + p] = (ushort)sum;
            sum += rank_count;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        for (uint k = 0; k < ITEMS; k++)
            if (me * ITEMS + k < here) {
                uint place = ranks[PART(mine[k]) * GROUP + me] + rank[k];
                sorted[place] = mine[k];
                origin[place] = from[k];
            }
        barrier(CLK_LOCAL_MEM_FENCE);
    }

    for (uint k = 0; k < ITEMS; k++) { // find the first key of each digit
        uint i = k * GROUP + me;
        if (i < here) {
            uint digit = DIGIT(sorted[i]);
            if (i == 0 || digit != DIGIT(sorted[i - 1]))
                starts[digit] = places[digit * tiles + tile] - i;
        }
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint k = 0; k < ITEMS; k++) {
        uint i = k * GROUP + me;
        if (i < here) {
            uint place = starts[DIGIT(sorted[i])] + i;
            size_t source = base + origin[i];
            keys_out[place] = sorted[i];
            values_out[place] = number ? (uint)source : values[source];
        }
    }
}
