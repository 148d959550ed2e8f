// Visit a vertex with any number of faces.
// The neighbours of the vertex are sorted, so the faces at an edge are consecutive.
// Radix sorts take the same time for any mesh.

#define DIGIT 8
#define BY_Z 1 // side (edge at the vertex) of a face: to neighbour y (0) or z (1)
#define RIM_SIDE 0xffffffffu   // the other end of a boundary edge
#define CROWD_SIDE 0xfffffffeu // the other end of an edge with more than two faces

// Stable sort of `count` words by their upper halves, which are less than `end`.
// Return a pointer to the sorted words, either `words` or `other`.
__global ulong *sort_upper(__global ulong *words, __global ulong *other, uint count, uint end)
{
    uint places[1 << DIGIT];
    for (uint shift = 0; shift < 32 && (end - 1) >> shift; shift += DIGIT) {
        for (int d = 0; d < 1 << DIGIT; d++)
            places[d] = 0;
        for (uint i = 0; i < count; i++)
            places[words[i] >> (32 + shift) & ((1 << DIGIT) - 1)]++;
        for (uint d = 0, sum = 0; d < 1 << DIGIT; d++) {
            uint here = places[d];
            places[d] = sum;
            sum += here;
        }
        for (uint i = 0; i < count; i++)
            other[places[words[i] >> (32 + shift) & ((1 << DIGIT) - 1)]++] = words[i];
        __global ulong *swap = words;
        words = other;
        other = swap;
    }
    return words;
}

#define UPPER(word) ((uint)((word) >> 32))
#define WORD(upper, lower) ((ulong)(upper) << 32 | (lower))

// Count duplicate faces whose lowest vertex is v, including faces with a repeated vertex.
// Two faces are duplicates if their two other vertices are the same.
void count_duplicates(__global const Record *records, uint count, Visit *visit, uint v, uint vertices)
{
    __global ulong *words = visit->scratch, *other = words + count;
    uint n = 0;
    for (uint i = 0; i < count; i++)
        if (!(records[i].w & COPY) && records[i].y >= v && records[i].z >= v)
            words[n++] = WORD(MAX(records[i].y, records[i].z), i);
    if (n < 2)
        return;
    words = sort_upper(words, other, n, vertices);
    for (uint k = 0; k < n; k++) {
        Record r = records[(uint)words[k]];
        words[k] = WORD(MIN(r.y, r.z), (uint)words[k]);
    }
    words = sort_upper(words, words == other ? visit->scratch : other, n, vertices);
    for (uint k = 0, next; k < n; k = next) {
        Record representative = records[(uint)words[k]];
        uint first = FACE(representative);
        for (next = k + 1; next < n; next++) {
            Record r = records[(uint)words[next]];
            if (UPPER(words[next]) != UPPER(words[k]) || MAX(r.y, r.z) != MAX(representative.y, representative.z))
                break;
            first = MIN(first, FACE(r));
        }
        for (uint i = k; i < next && next > k + 1; i++)
            if (FACE(records[(uint)words[i]]) != first)
                count_duplicate(visit->tally, FACE(records[(uint)words[i]]));
    }
}

// Return the group (fan of connected faces) of a corner at the vertex.
// The visit replaces the vertex in the first word of a corner's record by the parent of the corner.
uint find_group(__global Record *records, uint i)
{
    while (records[i].x != i) {
        records[i].x = records[records[i].x].x;
        i = records[i].x;
    }
    return i;
}

void link_large_rims(__global const Record *records, uint count, Visit *visit, __global const uint *across)
{
    for (uint i = 0; i < count; i++) {
        int y = across[2 * i] == RIM_SIDE, z = across[2 * i + BY_Z] == RIM_SIDE;
        if (y && z)
            visit->tally->rim_links++;
        if (y == z)
            continue;
        uint side = across[2 * i + (y ? BY_Z : 0)];
        while (side < CROWD_SIDE) {
            uint leave = side ^ 1;
            if (across[leave] == RIM_SIDE && leave / 2 > i) { // count each fan once, not from both ends
                visit->tally->rim_links++;
                add_pair(visit, RIM, records[i].w, records[leave / 2].w);
            }
            side = across[leave];
        }
    }
}

// Visit vertex v with the corners `records`, which all belong to faces with three different vertices.
void visit_large(__global Record *records, uint count, Visit *visit, uint v, uint vertices)
{
    __global Tally *t = visit->tally;
    __global ulong *words = visit->scratch, *other = words + 2 * (size_t)count;
    for (uint i = 0; i < count; i++) {
        // Each side (edge at the vertex) is one word. The upper half is the neighbour vertex, and the lower
        // half is the index of the side.
        words[2 * (size_t)i] = WORD(records[i].y, 2 * i);
        words[2 * (size_t)i + 1] = WORD(records[i].z, 2 * i + BY_Z);
        records[i].x = i;
    }
    words = sort_upper(words, other, 2 * count, vertices);
    // For each side, this array holds the opposite side.
    // The array uses the half of the scratch memory that the words leave free.
    __global uint *across = (__global uint *)(words == other ? visit->scratch : other);
    uint valence = 0, most = 0, groups = count;
    // Each run of equal neighbours is an edge with n faces.
    for (uint k = 0, next; k < 2 * count; k = next) {
        uint w = UPPER(words[k]), side = (uint)words[k], n;
        for (next = k + 1; next < 2 * count && UPPER(words[next]) == w; next++)
            ;
        n = next - k;
        valence++;
        most = MAX(most, n);
        int kind = n == 1 ? BOUNDARY_EDGES : NONMANIFOLD_EDGES;
        if (n == 1)
            across[side] = RIM_SIDE;
        else if (n == 2) {
            uint other_side = (uint)words[k + 1];
            across[side] = other_side;
            across[other_side] = side;
            kind = ((side ^ other_side) & 1) == 0 ? FLIPPED_EDGES : -1;
        }
        for (uint i = k; i < next; i++) {
            if (n > 2)
                across[(uint)words[i]] = CROWD_SIDE;
            // Join the corners at the edge into one group. At the edge's lower vertex, also list the pairs of
            // faces.
            uint a = find_group(records, side / 2), b = find_group(records, (uint)words[i] / 2);
            groups -= a != b;
            records[MAX(a, b)].x = MIN(a, b);
            if (i > k && w > v)
                add_pair(visit, n == 2 ? TWO_FACE : CROWDED, records[side / 2].w, records[(uint)words[i] / 2].w);
        }
        if (w > v) {
            if (kind >= 0 && count_edges(t, kind, 1))
                list_edge(t, kind, t->edge_counts[kind] - 1, visit->block, visit->rank, v, w);
            visit->rank++;
        }
    }
    count_valence(visit, valence);
    link_large_rims(records, count, visit, across);
    for (uint i = 0; i < count; i++)
        records[i].x = v;
    count_fans(visit, v, most, groups > 1);
}
