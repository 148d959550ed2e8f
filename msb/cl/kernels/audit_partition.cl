// Corners to blocks of 2^shift vertices: a counting sort by block, each work-item a contiguous chunk of the faces.
// A block fits into a core's cache, where its vertices are visited in any order at no cost; a scatter of the corners
// to all vertices at once would miss the cache with every write.

// `counts` has a row of `blocks` for each work-item; parents are made ready for unite_pairs; `improper` has for each
// work-item how many of its faces name a vertex twice, and the first of them.
__kernel void count_corners(__global const uint *restrict faces, __global uint *restrict counts,
    __global uint *restrict parents, __global uint *restrict improper, uint face_count, uint chunk, uint blocks,
    uint shift)
{
    size_t item = get_global_id(0);
    uint from = MIN((ulong)face_count, item * (ulong)chunk), to = MIN(face_count, from + chunk);
    __global uint *row = counts + item * blocks, *found = improper + (SAMPLES + 1) * item;
    for (uint k = 0; k < blocks; k++)
        row[k] = 0;
    uint n = 0;
    for (uint f = from; f < to; f++) {
        __global const uint *face = faces + 3 * (size_t)f;
        uint a = face[0], b = face[1], c = face[2];
        parents[f] = f;
        row[a >> shift]++;
        if (a != b && b != c && a != c) {
            row[b >> shift]++;
            row[c >> shift]++;
            continue;
        }
        if (n < SAMPLES)
            found[1 + n] = f;
        n++;
        if (b != a)
            row[b >> shift]++;
        if (c != a && c != b)
            row[c >> shift]++;
    }
    found[0] = n;
}

// Write the records of the blocks `first` to `first` + `count` - 1. `cursors` has for each work-item and block where
// its next record goes, and a spare one for all other blocks: writing them there costs less than a branch that no
// processor can foresee.
#define PLACE(v, y, z, f)                                                                                       \
    {                                                                                                           \
        uint k = ((v) >> shift) - first;                                                                        \
        k = k < count ? k : count;                                                                              \
        uint place = row[k];                                                                                    \
        row[k] = place + (k < count);                                                                           \
        records[place] = (Record)(v, y, z, f);                                                                  \
    }
__kernel void place_corners(__global const uint *restrict faces, __global Record *restrict records,
    __global uint *restrict cursors, uint face_count, uint chunk, uint first, uint count, uint shift)
{
    size_t item = get_global_id(0);
    uint from = MIN((ulong)face_count, item * (ulong)chunk), to = MIN(face_count, from + chunk);
    __global uint *row = cursors + item * (count + 1);
    for (uint f = from; f < to; f++) {
        __global const uint *face = faces + 3 * (size_t)f;
        uint a = face[0], b = face[1], c = face[2];
        if (a != b && b != c && a != c) {
            PLACE(a, b, c, f)
            PLACE(b, c, a, f)
            PLACE(c, a, b, f)
            continue;
        }
        uint low = MIN(a, MIN(b, c)), high = MAX(a, MAX(b, c)), middle = a + b + c - low - high;
        PLACE(low, middle, high, f | IMPROPER)
        if (high != low)
            PLACE(high, high, high, f | IMPROPER | COPY)
    }
}
