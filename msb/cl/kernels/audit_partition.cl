// Sort corners into blocks of 2^shift vertices by a counting sort.
// Each work-item takes a contiguous chunk of faces.
// A block fits into the cache of a processor core, so its vertices can be visited in any order.
// Scattering corners directly to all vertices would miss the cache with every write.

// The matrix `counts` has one row of `blocks` numbers per work-item.
// The kernel initialises `parents` for unite_pairs.
// For each work-item, `improper` gets the number of faces with a repeated index and the first such face.
__kernel void count_corners(__global const uint *restrict faces, __global uint *restrict counts,
    __global uint *restrict parents, __global uint *restrict improper, uint face_count, uint chunk, uint blocks,
    uint shift)
{
    size_t item = get_global_id(0);
    uint from = MIN((ulong)face_count, item * (ulong)chunk), to = MIN(face_count, from + chunk);
    __global uint *row = counts + item * blocks, *samples = improper + (SAMPLES + 1) * item;
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
            samples[1 + n] = f;
        n++;
        if (b != a)
            row[b >> shift]++;
        if (c != a && c != b)
            row[c >> shift]++;
    }
    samples[0] = n;
}

// Write the corner records of the blocks from `first` to `first` + `count` - 1.
// For each work-item, `cursors` holds the next write position in each block.
// Records of all other blocks go to one spare position. Writing to the spare position is faster than a branch
// that the processor cannot predict.
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
