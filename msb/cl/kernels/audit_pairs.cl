// Pairs of faces that the visits of vertices find, and the union of them: components of a graph of faces.

// Kinds of pairs: faces of a two-face edge; faces of an edge with more, each with the first; faces whose boundary
// edges follow each other around a vertex.
#define TWO_FACE 0
#define CROWDED 1
#define RIM 2
#define KINDS 3

// All kinds lie in one array, in chunks of PAIRS of one kind: together there are at most as many pairs as half-edges,
// but of each kind there may be as many. `fills` says of each chunk how many pairs it has and of which kind.
// A position is never at the end of a chunk, see `make_room`, so it tells its chunk. Chunk 0 is left out.
void close_list(Visit *visit, int kind)
{
    ulong at = visit->at[kind];
    if (at)
        visit->fills[at / PAIRS] = (uint)(at % PAIRS) << 2 | kind;
}

// Let `count` more pairs of a kind fit into its chunk, and one to spare.
void make_room(Visit *visit, int kind, uint count)
{
    ulong at = visit->at[kind];
    if (at && at % PAIRS + count < PAIRS)
        return;
    close_list(visit, kind);
    visit->at[kind] = (ulong)(atomic_inc(visit->next_chunk) + 1) * PAIRS;
}

void add_pair(Visit *visit, int kind, uint one, uint other)
{
    make_room(visit, kind, 1);
    visit->pairs[visit->at[kind]++] = (uint2)(one, other);
}

// ---- union

// The root of a face's tree, which is its lowest face. Paths are halved on the way, and others may do so at the same
// time: whatever is written is an ancestor, and only roots are ever linked.
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

// Join the trees of two faces; return whether they were two. However many do so at the same time and in whatever
// order, the trees at the end hold the same sets, and the number of joins is that of faces less that of sets.
int unite(__global volatile uint *parents, uint one, uint other)
{
    for (;;) {
        one = find_root(parents, one);
        other = find_root(parents, other);
        if (one == other)
            return 0;
        uint low = one < other ? one : other, high = one < other ? other : one;
        if (atomic_cmpxchg(parents + high, high, low) == high)
            return 1;
    }
}

#define AHEAD 32 // pairs: a union that finds its faces in the cache takes a fraction of one that waits for them

// Unite all pairs of one kind; `joined` gets for each work-item how many unions joined two trees.
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
