// Pairs of faces found by visiting vertices, and their union into components of a graph of faces.

// Kinds of pairs: the faces of a two-face edge; the first and each further face of an edge with more faces; faces
// with boundary edges that follow each other around a vertex.
#define TWO_FACE 0
#define CROWDED 1
#define RIM 2
#define KINDS 3

// All kinds share one array, in chunks of PAIRS pairs of one kind: in total there are at most as many pairs as
// half-edges, but any kind may have all of them. `fills` holds the number and kind of pairs of each chunk. A
// position is never at the end of a chunk (see `make_room`), so it determines its chunk. Chunk 0 is unused.
void close_list(Visit *visit, int kind)
{
    ulong at = visit->at[kind];
    if (at)
        visit->fills[at / PAIRS] = (uint)(at % PAIRS) << 2 | kind;
}

// Ensure that `count` more pairs of a kind fit into its chunk, plus one.
void make_room(Visit *visit, int kind, uint count)
{
    ulong at = visit->at[kind];
    if (at && at % PAIRS + count < PAIRS)
        return;
    close_list(visit, kind);
    visit->at[kind] = (ulong)(atomic_inc(visit->next_chunk) + 1) * PAIRS;
}

void add_pair(Visit *visit, int kind, uint first, uint second)
{
    make_room(visit, kind, 1);
    visit->pairs[visit->at[kind]++] = (uint2)(first, second);
}

// ---- union

// Return the root of the tree of a face, which is its lowest face. Paths are halved on the way. Concurrent changes
// are safe: only ancestors are ever written, and only roots are linked.
uint find_root(__global volatile uint *parents, uint f)
{
    for (;;) {
        uint above = parents[f];
        if (above == f)
            return f;
        uint higher = parents[above];
        if (higher == above)
            return above;
        parents[f] = higher;
        f = higher;
    }
}

// Join the trees of two faces; return whether they were different. Independent of concurrency and order, the final
// trees hold the same sets, and the number of joins is the number of faces minus the number of sets.
int unite(__global volatile uint *parents, uint first, uint second)
{
    for (;;) {
        first = find_root(parents, first);
        second = find_root(parents, second);
        if (first == second)
            return 0;
        uint low = first < second ? first : second, high = first < second ? second : first;
        if (atomic_cmpxchg(parents + high, high, low) == high)
            return 1;
    }
}

#define AHEAD 32 // number of pairs to prefetch; uniting cached faces takes a fraction of the time

// Unite all pairs of a kind; `joined` gets the number of successful joins of each work-item.
__kernel void unite_pairs(__global const uint2 *restrict pairs, __global const uint *restrict fills,
    __global uint *parents, __global uint *next, __global uint *joined, uint chunks, uint kind)
{
    uint n = 0;
    for (;;) {
        uint c = atomic_inc(next) + 1;
        if (c > chunks)
            break;
        uint fill = fills[c];
        if ((fill & 3) != kind)
            continue;
        __global const uint2 *chunk = pairs + (size_t)c * PAIRS;
        uint count = fill >> 2;
        for (uint i = 0; i < count; i++) {
            uint2 soon = chunk[i + AHEAD < count ? i + AHEAD : i];
            PREFETCH(parents + soon.x);
            PREFETCH(parents + soon.y);
            uint2 next = chunk[i + AHEAD / 2 < count ? i + AHEAD / 2 : i];
            PREFETCH(parents + parents[next.x]);
            PREFETCH(parents + parents[next.y]);
            n += unite(parents, chunk[i].x, chunk[i].y);
        }
    }
    joined[get_global_id(0)] = n;
}
