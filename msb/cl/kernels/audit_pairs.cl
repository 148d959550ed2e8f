// Pairs of faces that were found at the vertices.
// Uniting the pairs gives the connected components of all faces.

// There are three kinds of pairs.
// The first kind is the two faces of an edge.
// The second kind is the first face and each further face of an edge with more than two faces.
// The third kind is two faces whose boundary edges follow each other around a vertex.
#define TWO_FACE 0
#define CROWDED 1
#define RIM 2
#define KINDS 3

// All kinds share one array, in chunks of PAIRS pairs of one kind.
// The total number of pairs is at most the number of half-edges, and a single kind may reach this number.
// `fills` holds the number and kind of pairs of each chunk.
// A position is never the end of a chunk (see `make_room`), so the position determines the chunk.
// Chunk 0 is unused.
void close_list(Visit *visit, int kind)
{
    ulong at = visit->at[kind];
    if (at)
        visit->fills[at / PAIRS] = (uint)(at % PAIRS) << 2 | kind;
}

// Ensure that a chunk has room for `count` + 1 more pairs of a kind.
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

// Return the root of the tree of a face, which is the lowest face of the tree.
// The search halves the paths to the root.
// Concurrent changes are safe, because only roots are linked, and a new parent is always an ancestor.
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

// Join the trees of two faces; return whether they were different.
// The final trees do not depend on the order of execution.
// The number of successful joins is the number of faces minus the number of components.
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

#define AHEAD 32 // number of pairs to prefetch ahead; uniting cached faces takes a fraction of the time

// Unite all pairs of a kind; `joined` gets the number of successful joins by each work-item.
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
