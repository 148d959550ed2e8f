// Faces of equal depth must be blended in order of their numbers.
// Faces are stored in another order (splat_order.cl), and the sort by depth keeps this order at equal depths.
// Equal depths are rare, so the order of such faces is corrected after the sort.

#define LONGEST_RUN 32
// msb/render/splat/pipeline.py defines MOST_SETTLED, a multiple of LANES.

// `keys` has the sorted depths, and `places` has the positions of the faces.
// If a run of equal keys begins at `first`, sorts the places of this run by face number.
// Sets `unsettled` if the run is too long.
void settle_run(__global const uint *keys, __global uint *places, __global const Face *faces,
                __global uint *unsettled, size_t first, size_t count)
{
    if (first > 0 && keys[first - 1] == keys[first])
        return;
    size_t last = first + 1;
    for (; last < count && keys[last] == keys[first] && last - first <= LONGEST_RUN; last++) {
        uint place = places[last];
        int number = faces[place].number;
        size_t free = last;
        for (; free > first && faces[places[free - 1]].number > number; free--)
            places[free] = places[free - 1];
        places[free] = place;
    }
    if (last - first > LONGEST_RUN)
        *unsettled = 1;
}

#if LANES == 8
// A work-item takes the runs that begin in its chunk of at most MOST_SETTLED faces.
// Faces are scattered in memory, so they are prefetched before the first face is needed.
__kernel void settle_ties(__global const uint *keys, __global uint *places, __global const Face *faces,
                          __global uint *unsettled, uint count, uint chunk)
{
    size_t begin = get_global_id(0) * chunk, end = begin + chunk < count ? begin + chunk : count;
    uint equal[MOST_SETTLED], count_found = 0;
    for (size_t i = begin; i < end; i += LANES) {
        uint ties = 0;
        if (i + LANES < count)
            ties = bits8(LOAD_INT(keys + i) == LOAD_INT(keys + i + 1));
        else
            for (uint k = 0; i + k + 1 < count; k++)
                ties |= (keys[i + k] == keys[i + k + 1]) << k;
        for (; ties; ties &= ties - 1) {
            size_t first = i + LOWEST_BIT(ties);
            PREFETCH_FAR(&faces[places[first]].number);
            PREFETCH_FAR(&faces[places[first + 1]].number);
            equal[count_found++] = (uint)first;
        }
    }
    for (uint k = 0; k < count_found; k++)
        settle_run(keys, places, faces, unsettled, equal[k], count);
}
#else
__kernel void settle_ties(__global const uint *keys, __global uint *places, __global const Face *faces,
                          __global uint *unsettled, uint count)
{
    size_t i = get_global_id(0);
    if (i + 1 < count && keys[i] == keys[i + 1])
        settle_run(keys, places, faces, unsettled, i, count);
}
#endif

__kernel void numbers_of(__global const uint *places, __global const Face *faces, __global uint *numbers,
                         uint count)
{
    size_t i = get_global_id(0);
    if (i < count)
        numbers[i] = (uint)faces[places[i]].number;
}

__kernel void depths_of(__global const uint *places, __global const uint *keys, __global uint *depths,
                        uint count)
{
    size_t i = get_global_id(0);
    if (i < count)
        depths[i] = keys[places[i]];
}

// `visible` is ordered by row, and `result` is ordered by face number.
__kernel void visible_by_number(__global const uchar *visible, __global const uint *numbers,
                                __global uchar *result, uint count)
{
    size_t i = get_global_id(0);
    if (i < count)
        result[numbers[i]] = visible[i];
}
