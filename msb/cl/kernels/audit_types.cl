// Types that the audit kernels share: the record of a corner, and the counts and lists of a work-item.

// A corner in its block: its vertex, the two other vertices in the order of the face, and the face. Faces with a
// repeated index take part only in the search for duplicates and for shared vertices: they have a record at each
// of their different vertices. At the lowest vertex, y and z are the other two, ascending; at the other one the
// record is a COPY.
typedef uint4 Record;
#define IMPROPER 0x80000000u
#define COPY 0x40000000u
#define FACE(record) ((record).w & ~(IMPROPER | COPY))

#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))
#define NOBODY 0xffffffffu // an invalid number of a vertex or face

#ifdef __clang__
#define COUNT_BITS(x) ((uint)__builtin_popcount(x))
#define LOWEST_BIT_OF_LONG(x) ((uint)__builtin_ctzl(x))
#else
#define COUNT_BITS(x) popcount(x)
#define LOWEST_BIT_OF_LONG(x) ((uint)(63 - clz((x) & -(x))))
#endif

// msb/topology/kernel.py sets four sizes. SAMPLES elements of each kind are listed. Vertices with fewer than
// VALENCES edges are counted in a table, and the valences of others are listed. For MOST and PAIRS see
// audit_small.cl and audit_pairs.cl.

#define NONMANIFOLD_EDGES 0 // kinds of listed edges
#define BOUNDARY_EDGES 1
#define FLIPPED_EDGES 2
#define NONMANIFOLD_VERTICES 0 // kinds of listed vertices
#define MULTIFAN_VERTICES 1
#define EDGE_ENDPOINTS 2
#define UNREFERENCED_VERTICES 3

// An edge by its two vertices, and its rank among the edges of its block, sorted by lower, then higher vertex.
typedef struct {
    ulong block, rank, low, high;
} EdgeSample;

// msb/topology/tally.py reads it as a record with the same fields.
typedef struct {
    ulong max_edge_faces, rim_links, shared_vertices, duplicate_faces;
    ulong edge_counts[3], vertex_counts[4];
    EdgeSample edge_samples[3][SAMPLES];
    ulong vertex_samples[4][SAMPLES];
    ulong duplicate_samples[SAMPLES];
    ulong valences[VALENCES];
} Tally;

// The state of a work-item that visits vertices.
typedef struct {
    __global Tally *tally;
    __global uint *valences, *next_valence; // valences of vertices with at least VALENCES edges
    __global ulong *scratch; // four words for each corner of the vertex
    uint block;
    ulong rank; // edges already counted in the block
    // Pairs of faces, see audit_pairs.cl.
    __global uint2 *pairs;
    __global uint *fills, *next_chunk;
    ulong at[3];
} Visit;

// Work-items meet vertices and edges in ascending order, so the first few are the lowest.
void count_vertex(__global Tally *t, int kind, uint v)
{
    ulong n = t->vertex_counts[kind]++;
    if (n < SAMPLES)
        t->vertex_samples[kind][n] = v;
}

// Count `count` edges of a kind; return whether some of them should be listed.
int count_edges(__global Tally *t, int kind, uint count)
{
    ulong before = t->edge_counts[kind];
    t->edge_counts[kind] = before + count;
    return count && before < SAMPLES;
}

void list_edge(__global Tally *t, int kind, ulong number, uint block, ulong rank, uint low, uint high)
{
    if (number < SAMPLES) {
        EdgeSample sample = {block, rank, low, high};
        t->edge_samples[kind][number] = sample;
    }
}

// Duplicates are met in the order of vertices, not of faces: keep the lowest, sorted.
void count_duplicate(__global Tally *t, uint f)
{
    ulong n = t->duplicate_faces++;
    if (n >= SAMPLES && t->duplicate_samples[SAMPLES - 1] < f)
        return;
    int i = n < SAMPLES ? (int)n : SAMPLES - 1;
    for (; i > 0 && t->duplicate_samples[i - 1] > f; i--)
        t->duplicate_samples[i] = t->duplicate_samples[i - 1];
    t->duplicate_samples[i] = f;
}

void count_valence(Visit *visit, uint valence)
{
    if (valence < VALENCES)
        visit->tally->valences[valence]++;
    else
        visit->valences[atomic_inc(visit->next_valence)] = valence;
}

// Count vertex v by kind: `most` is the largest number of faces at its edges; `in_groups` tells whether its faces
// form several groups.
void count_fans(Visit *visit, uint v, uint most, int in_groups)
{
    __global Tally *t = visit->tally;
    if (t->max_edge_faces < most)
        t->max_edge_faces = most;
    if (most > 2)
        count_vertex(t, EDGE_ENDPOINTS, v);
    if (in_groups)
        count_vertex(t, MULTIFAN_VERTICES, v);
    if (most > 2 || in_groups)
        count_vertex(t, NONMANIFOLD_VERTICES, v);
}
