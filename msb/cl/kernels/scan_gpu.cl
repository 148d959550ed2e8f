// Exclusive prefix sum in GPU style.
// Each of the GROUP work-items of a group takes ITEMS consecutive elements.
// VALUE is uint, or equals SUM when the sums of a lower level are scanned.
// The type SUM is uint or ulong.

#include "group_scan.cl"

#define TILE (GROUP * ITEMS)

__kernel void sum_tiles(__global const VALUE *values, __global SUM *sums, uint count)
{
    __local SUM shared[GROUP];
    size_t tile = get_group_id(0), me = get_local_id(0);
    SUM sum = 0, total;
    for (uint k = 0; k < ITEMS; k++) { // adjacent work-items read adjacent elements
        size_t i = tile * TILE + k * GROUP + me;
        sum += i < count ? values[i] : 0;
    }
    group_scan(sum, shared, &total);
    if (me == 0)
        sums[tile] = total;
}

// sums[tile] is the sum of a tile.
// If `scanned` is set, sums[tile] is the sum of all preceding tiles.
// `offsets` may share the memory of `values`.
// If there are few sums, each work-group adds the preceding sums, so no other scan is launched.
__kernel void scan_tiles(__global const VALUE *values, __global const SUM *sums, __global SUM *offsets,
                         uint count, uint scanned)
{
    __local SUM shared[GROUP];
    size_t tile = get_group_id(0), me = get_local_id(0), first = tile * TILE + me * ITEMS;
    SUM mine[ITEMS], sum = 0, before = 0, total;
    if (scanned)
        before = sums[tile];
    else if (tile > 0) { // condition is uniform within the work-group
        for (size_t t = me; t < tile; t += GROUP)
            sum += sums[t];
        group_scan(sum, shared, &before);
        sum = 0;
    }
    for (uint k = 0; k < ITEMS; k++) {
        mine[k] = first + k < count ? values[first + k] : 0;
        sum += mine[k];
    }
    sum = group_scan(sum, shared, &total) + before;
    for (uint k = 0; k < ITEMS; k++) {
        if (first + k < count)
            offsets[first + k] = sum;
        sum += mine[k];
        if (first + k + 1 == count)
            offsets[count] = sum;
    }
}
