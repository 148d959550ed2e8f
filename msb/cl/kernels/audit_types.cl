// What the audit's kernels share: a corner's record, and what a work-item has counted and listed.

// A corner as it lies in its block: vertex, the two others of the face in the order in which the face runs, face.
// Faces that name a vertex twice are there for duplicates and for "used by two faces" alone: one record at each of
// their different vertices. At the lowest, y and z are the other two, ascending; at the other it is a COPY.
typedef uint4 Record;
#define IMPROPER 0x80000000u
#define COPY 0x40000000u
#define FACE(record) ((record).w & ~(IMPROPER | COPY))

#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))
#define NOBODY 0xffffffffu // no vertex has this number, nor has any face

#ifdef __clang__
#define COUNT_BITS(x) ((uint)__builtin_popcount(x))
#define LOWEST_BIT_OF_LONG(x) ((uint)__builtin_ctzl(x))
#else
#define COUNT_BITS(x) popcount(x)
#define LOWEST_BIT_OF_LONG(x) ((uint)(63 - clz((x) & -(x))))
#endif

// msb/topology/kernel.py sets four sizes. SAMPLES elements of each kind are listed; vertices with fewer edges than
// VALENCES are counted in a table, the others listed; for MOST and PAIRS see audit_small.cl and audit_pairs.cl.

#define NONMANIFOLD_EDGES 0 // kinds of edges that are listed
#define BOUNDARY_EDGES 1
#define FLIPPED_EDGES 2
#define NONMANIFOLD_VERTICES 0 // and of vertices
#define MULTIFAN_VERTICES 1
#define EDGE_ENDPOINTS 2
#define UNREFERENCED_VERTICES 3

// An edge by its two vertices, and its number among the edges of its block, by the lower vertex, then the higher.
typedef struct {
    ulong block, rank, low, high;
} EdgeSample;

// msb/topology/tally.py reads it as a record of the same fields.
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
    __global uint *valences, *next_valence; // of vertices with VALENCES edges and more
    __global ulong *scratch; // four words for each corner of the vertex
    uint block;
    ulong rank; // edges of the block so far
    // Pairs of faces, see audit_pairs.cl
    __global uint2 *pairs;
    __global uint *fills, *next_chunk;
    ulong at[3];
} Visit;

// Work-items meet vertices, and with them edges, in ascending order: the first few are the lowest.
void count_vertex(__global Tally *t, int kind, uint v)
{
    ulong n = t->vertex_counts[kind]++;
    if (n < SAMPLES)
        t->vertex_samples[kind][n] = v;
}

// Count `count` edges of a kind; return whether more of them should be listed.
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

// Duplicates are met in the order of their vertices, not of their faces: keep the lowest, ascending.
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

// Count what vertex v is: `most` faces at any of its edges, and whether its faces are in several groups.
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
