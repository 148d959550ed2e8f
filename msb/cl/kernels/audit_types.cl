// Types that the audit kernels share: the record of a face corner, and the counts and lists of a work-item.

// The record of a corner: its vertex, the two other vertices in the order of the face, and the face.
// Faces with a repeated index take part only in the search for duplicates and for shared vertices.
// A face with a repeated index has a record at each of its distinct vertices.
// At the face's lowest vertex, y and z of the record are the other two vertices in ascending order.
// At the face's other vertex, the record is marked COPY.
typedef uint4 Record;
#define IMPROPER 0x80000000u
#define COPY 0x40000000u
#define FACE(record) ((record).w & ~(IMPROPER | COPY))

#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))
#define NOBODY 0xffffffffu // an invalid vertex or face number

#ifdef __clang__
#define COUNT_BITS(x) ((uint)__builtin_popcount(x))
#define LOWEST_BIT_OF_LONG(x) ((uint)__builtin_ctzl(x))
#else
#define COUNT_BITS(x) popcount(x)
#define LOWEST_BIT_OF_LONG(x) ((uint)(63 - clz((x) & -(x))))
#endif

// The host code msb/topology/kernel.py sets four sizes.
// SAMPLES is the number of listed elements of each kind.
// A table counts vertices with fewer than VALENCES edges, and a list holds the valences of other vertices.
// MOST is explained in audit_small.cl, and PAIRS in audit_pairs.cl.

#define NONMANIFOLD_EDGES 0 // kinds of listed edges
#define BOUNDARY_EDGES 1
#define FLIPPED_EDGES 2
#define NONMANIFOLD_VERTICES 0 // kinds of listed vertices
#define MULTIFAN_VERTICES 1
#define EDGE_ENDPOINTS 2
#define UNREFERENCED_VERTICES 3

// An edge with its two vertices, and its rank in its block.
// Ranks order the edges by the lower vertex, then by the higher vertex.
typedef struct {
    ulong block, rank, low, high;
} EdgeSample;

// msb/topology/tally.py reads this struct as a record with the same fields.
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
    __global ulong *scratch; // four words per corner of the vertex
    uint block;
    ulong rank; // number of edges already counted in the block
    // Pairs of faces are explained in audit_pairs.cl.
    __global uint2 *pairs;
    __global uint *fills, *next_chunk;
    ulong at[3];
} Visit;

// Work-items process vertices and edges in ascending order, so the first listed elements have the lowest
// indices.
void count_vertex(__global Tally *t, int kind, uint v)
{
    ulong n = t->vertex_counts[kind]++;
    if (n < SAMPLES)
        t->vertex_samples[kind][n] = v;
}

// Add `count` edges to the count of one kind. Return whether the list of this kind has room for an edge.
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

// Duplicates are found in the order of vertices, so a sorted list keeps the lowest faces.
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

// Add vertex v to the counts of its kinds. The number `most` is the largest number of faces at an edge of v.
// `in_groups` tells whether the faces of v form several groups.
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
