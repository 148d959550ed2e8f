// Visit a vertex with at most MOST faces; MOST is a multiple of 8, at most 32.
// All pairs of sides (edges at the vertex) are compared, eight pairs at a time.
// The result is one word per side; its bits mark the faces with the same neighbour vertex.
// The comparison takes quadratic time, but is faster than sorting, because the comparison has no
// unpredictable branches.

typedef uint8 __attribute__((aligned(4))) loose_uint8;
#define LANES(words) (*(loose_uint8 *)(words))

// A face at the vertex has two sides, y and z.
// The sides are the edges from the vertex to the two other vertices, in the order of the face.
typedef struct {
    uint neighbour[2 * MOST]; // ordered by side: first all y, then all z; unused lanes hold NOBODY
    uint sharing[2 * MOST];   // bits of the faces that have the same neighbour
    uint same[2 * MOST];      // bits of the faces that have this neighbour on the same side
    uint face[MOST];
    uint count;
} Star;

uint or_lanes(uint8 v) { return (uint)or8(as_int8(v)); }

uint sum_lanes(uint8 v)
{
    uint4 four = v.lo + v.hi;
    uint2 two = four.lo + four.hi;
    return two.x + two.y;
}

#define BIT(i) (1u << (i))
#define REST(bits) ((bits) & ((bits) - 1)) // all set bits except the lowest

// Sums over the sides of a vertex, separately for each lane.
// `counts` packs five numbers, with enough bits for 64 sides.
// Two of the numbers are the count of all edges, and the count of the edges to higher vertices. Three numbers
// count edges to higher vertices by kind: boundary edges, two-face edges with flipped winding, and edges with
// more than two faces. `rim` marks the sides that are boundary edges. `paired` marks the sides that share a
// higher neighbour with an earlier side. `crowd` is non-zero at an edge with more than two faces. `twins`
// marks the faces that share both neighbours with another face.
typedef struct {
    uint8 counts, rim[2], paired[2], crowd, twins;
} Sides;
#define VALENCE(counts) ((counts) & 127)
#define EDGES(counts) ((counts) >> 7 & 127)
#define BOUNDARY(counts) ((counts) >> 14 & 127)
#define FLIPPED(counts) ((counts) >> 21 & 63)
#define CROWDS(counts) ((counts) >> 27)

void count_sides(Sides *sums, int side, uint8 bit, uint8 neighbour, uint8 sharing, uint8 same, uint v)
{
    const uint8 none = 0;
    uint8 rest = REST(sharing), more = REST(rest);
    uint8 single = as_uint8(sharing != none) & as_uint8(rest == none);
    uint8 two = as_uint8(rest != none) & as_uint8(more == none), crowd = as_uint8(more != none);
    uint8 first = as_uint8((sharing & -sharing) == bit), up = as_uint8(neighbour > v);
    uint8 flipped = two & as_uint8(REST(same) != none);
    sums->counts += first & (1 | (up & (BIT(7) | (single & BIT(14)) | (flipped & BIT(21)) | (crowd & BIT(27)))));
    sums->rim[side] |= single & bit;
    sums->paired[side] |= up & ~first & as_uint8(rest != none) & bit;
    sums->crowd |= crowd;
}

// Compare all sides of a vertex: fill `sharing` and `same` of the star, and compute the sums over the sides.
void compare_sides(Star *s, Sides *sums, uint v)
{
    sums->counts = sums->rim[0] = sums->rim[1] = sums->paired[0] = sums->paired[1] = sums->crowd = sums->twins = 0;
    for (uint c = 0; c < s->count; c += 8) {
        uint8 y = LANES(s->neighbour + c), z = LANES(s->neighbour + MOST + c);
        uint8 at_y = 0, at_z = 0, same_y = 0, same_z = 0;
        for (uint i = 0; i < s->count; i++) {
            uint8 bit = BIT(i), other_y = s->neighbour[i], other_z = s->neighbour[MOST + i];
            uint8 yy = as_uint8(y == other_y) & bit, zz = as_uint8(z == other_z) & bit;
            same_y |= yy;
            same_z |= zz;
            at_y |= yy | (as_uint8(y == other_z) & bit);
            at_z |= zz | (as_uint8(z == other_y) & bit);
        }
        LANES(s->sharing + c) = at_y;
        LANES(s->sharing + MOST + c) = at_z;
        LANES(s->same + c) = same_y;
        LANES(s->same + MOST + c) = same_z;
        uint8 bits = (uint8)(1, 2, 4, 8, 16, 32, 64, 128) << c;
        count_sides(sums, 0, bits, y, at_y, same_y, v);
        count_sides(sums, 1, bits, z, at_z, same_z, v);
        sums->twins |= REST(at_y & at_z);
    }
}

// List the edges of one kind from v to higher vertices. The list already has `number` edges of this kind.
// Listing searches the faces of each edge again, but few vertices have edges to list.
void list_small(const Star *s, const Visit *visit, int kind, ulong number, uint v)
{
    uint last = v;
    for (ulong rank = visit->rank;; rank++) {
        uint next = NOBODY, faces = 0, same = 0;
        for (uint i = 0; i < 2 * MOST; i++)
            if (i % MOST < s->count && s->neighbour[i] > last && s->neighbour[i] < next) {
                next = s->neighbour[i];
                faces = COUNT_BITS(s->sharing[i]);
                same = COUNT_BITS(s->same[i]);
            }
        if (next == NOBODY)
            return;
        last = next;
        // If both faces traverse an edge in the same direction, the edge is side y of both faces, or side z
        // of both faces.
        int is_kind = kind == BOUNDARY_EDGES ? faces == 1 : kind == NONMANIFOLD_EDGES ? faces > 2
            : faces == 2 && same != 1;
        if (is_kind)
            list_edge(visit->tally, kind, number++, visit->block, rank, v, next);
    }
}

// Face i has a boundary edge at the vertex. Follow the fan of faces from face i to the other end of the fan.
// Return the face at the other end if its side is also a boundary edge, otherwise NOBODY. `rim_y` and `rim_z`
// mark the faces whose side y or z is a boundary edge.
uint other_end(const Star *s, uint i, uint rim_y, uint rim_z)
{
    uint through = s->sharing[rim_y & BIT(i) ? MOST + i : i];
    while (COUNT_BITS(through) == 2) {
        i = LOWEST_BIT(through & ~BIT(i));
        int by_y = s->sharing[i] == through; // no two faces of an open fan share both neighbours
        if ((by_y ? rim_z : rim_y) & BIT(i))
            return i;
        through = s->sharing[by_y ? MOST + i : i];
    }
    return NOBODY;
}

void link_rims(const Star *s, Visit *visit, uint rim_y, uint rim_z)
{
    uint links = COUNT_BITS(rim_y & rim_z); // fans with a single face
    for (uint ends = rim_y ^ rim_z; ends; ends &= ends - 1) {
        uint i = LOWEST_BIT(ends), j = other_end(s, i, rim_y, rim_z);
        if (j != NOBODY) {
            ends &= ~BIT(j);
            visit->pairs[visit->at[RIM]++] = (uint2)(s->face[i], s->face[j]);
            links++;
        }
    }
    visit->tally->rim_links += links;
}

// Return whether the faces, joined across all shared edges, form more than one group.
int in_groups(const Star *s)
{
    uint reached = 1, done = 0;
    for (uint todo = 1; todo; todo = reached & ~done) {
        uint i = LOWEST_BIT(todo);
        done |= BIT(i);
        reached |= s->sharing[i] | s->sharing[MOST + i];
    }
    return COUNT_BITS(done) != s->count;
}

uint most_sharing(const Star *s)
{
    uint most = 0;
    for (uint i = 0; i < s->count; i++)
        most = MAX(most, MAX(COUNT_BITS(s->sharing[i]), COUNT_BITS(s->sharing[MOST + i])));
    return most;
}

// Pair the first face with every face that shares a neighbour vertex with the first face. To avoid a branch,
// write the pair to the lists of both kinds. Only the position in the correct list advances.
void pair_faces(const Star *s, Visit *visit, uint paired_y, uint paired_z)
{
    __global uint2 *pairs = visit->pairs;
    ulong two_at = visit->at[TWO_FACE], crowd_at = visit->at[CROWDED];
    for (ulong paired = paired_y | (ulong)paired_z << MOST; paired; paired &= paired - 1) {
        uint side = LOWEST_BIT_OF_LONG(paired), sharing = s->sharing[side];
        uint2 pair = (uint2)(s->face[LOWEST_BIT(sharing)], s->face[side % MOST]);
        int two = REST(REST(sharing)) == 0;
        pairs[two_at] = pair;
        two_at += two;
        pairs[crowd_at] = pair;
        crowd_at += !two;
    }
    visit->at[TWO_FACE] = two_at;
    visit->at[CROWDED] = crowd_at;
}

// Visit vertex v with its faces `s` (at least one).
// Return whether two of the faces share both neighbours.
int visit_small(Star *s, Visit *visit, uint v)
{
    __global Tally *t = visit->tally;
    Sides sums;
    compare_sides(s, &sums, v);
    for (int kind = 0; kind < KINDS; kind++)
        make_room(visit, kind, 2 * MOST);
    uint counts = sum_lanes(sums.counts), rim_y = or_lanes(sums.rim[0]), rim_z = or_lanes(sums.rim[1]);
    pair_faces(s, visit, or_lanes(sums.paired[0]), or_lanes(sums.paired[1]));
    count_valence(visit, VALENCE(counts));
    if (count_edges(t, BOUNDARY_EDGES, BOUNDARY(counts)))
        list_small(s, visit, BOUNDARY_EDGES, t->edge_counts[BOUNDARY_EDGES] - BOUNDARY(counts), v);
    if (count_edges(t, FLIPPED_EDGES, FLIPPED(counts)))
        list_small(s, visit, FLIPPED_EDGES, t->edge_counts[FLIPPED_EDGES] - FLIPPED(counts), v);
    if (count_edges(t, NONMANIFOLD_EDGES, CROWDS(counts)))
        list_small(s, visit, NONMANIFOLD_EDGES, t->edge_counts[NONMANIFOLD_EDGES] - CROWDS(counts), v);
    visit->rank += EDGES(counts);
    if (rim_y | rim_z)
        link_rims(s, visit, rim_y, rim_z);
    uint most = or_lanes(sums.crowd) ? most_sharing(s) : EDGES(counts) > BOUNDARY(counts) ? 2 : 1;
    count_fans(visit, v, most, in_groups(s));
    return or_lanes(sums.twins) != 0;
}
