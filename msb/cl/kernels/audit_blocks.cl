// Visit the vertices of a block one after another, each with all its faces.

// Sort the corner records of a block by vertex into `sorted`.
// The first record of vertex i of the block is at starts[i].
void sort_block(__global const Record *restrict records, uint count, uint first, uint vertices,
    __global uint *restrict starts, __global Record *restrict sorted)
{
    for (uint i = 0; i <= vertices; i++)
        starts[i] = 0;
    for (uint i = 0; i < count; i++)
        starts[records[i].x - first]++;
    for (uint i = 0, sum = 0; i <= vertices; i++)
        starts[i] = sum += starts[i];
    // At first, starts[i] is the end of the records of vertex i.
    // The sort then moves starts[i] down to the first record of vertex i. Reading from the last record to the
    // first preserves the order of the records.
    for (uint i = count; i-- > 0;)
        sorted[--starts[records[i].x - first]] = records[i];
}

// Sort a block in place if a copy would take too much memory.
// Each record moves to its final position and displaces another record, which moves next.
// The array `next` has the size of `starts`.
void sort_block_in_place(__global Record *records, uint count, uint first, uint vertices, __global uint *starts,
    __global uint *next)
{
    for (uint i = 0; i <= vertices; i++)
        starts[i] = 0;
    for (uint i = 0; i < count; i++)
        starts[records[i].x - first + 1]++;
    for (uint i = 0, sum = 0; i <= vertices; i++)
        next[i] = starts[i] = sum += starts[i];
    for (uint i = 0; i < vertices; i++)
        while (next[i] < starts[i + 1]) {
            Record r = records[next[i]];
            for (uint k = r.x - first; k != i; k = r.x - first) {
                Record other = records[next[k]];
                records[next[k]++] = r;
                r = other;
            }
            records[next[i]++] = r;
        }
}

// Move the records of proper faces (three different vertices) to the front.
// Return the number of records of proper faces.
uint proper_first(__global Record *records, uint count)
{
    uint n = 0;
    for (uint i = 0; i < count; i++) {
        Record r = records[i];
        if (r.w & IMPROPER)
            continue;
        records[i] = records[n];
        records[n++] = r;
    }
    return n;
}

void visit_vertex(__global Record *records, uint count, Visit *visit, uint v, uint vertices)
{
    Star star;
    uint n = 0;
    visit->tally->shared_vertices += count > 1;
    if (count > MOST) {
        n = proper_first(records, count);
    } else {
        for (uint i = 0; i < count; i++) {
            Record r = records[i];
            star.neighbour[n] = r.y;
            star.neighbour[MOST + n] = r.z;
            star.face[n] = r.w;
            n += !(r.w & IMPROPER);
        }
        for (uint i = n; i & 7; i++)
            star.neighbour[i] = star.neighbour[MOST + i] = NOBODY;
        star.count = n;
    }
    int duplicates = count > n || n > MOST;
    if (n == 0) {
        count_vertex(visit->tally, UNREFERENCED_VERTICES, v);
        count_valence(visit, 0);
    } else if (count > MOST) {
        visit_large(records, n, visit, v, vertices);
    } else {
        duplicates |= visit_small(&star, visit, v);
    }
    if (duplicates)
        count_duplicates(records, count, visit, v, vertices);
}

// Visit the blocks from `first` to `first` + `count` - 1.
// Each work-item takes the next unvisited block until no block remains.
// If `large` is 0, only blocks with at most `limit` records are visited.
// If `large` is set, a single work-item visits the blocks with more than `limit` records.
__kernel void visit_blocks(__global Record *records, __global const uint *block_starts, __global ulong *block_edges,
    __global uint *next_block, __global Tally *tallies, __global uint *valences, __global uint *next_valence,
    __global uint2 *pairs, __global uint *fills, __global uint *next_chunk, __global ulong *scratch,
    ulong scratch_words, uint limit, uint large, uint first, uint count, uint shift, uint vertices)
{
    size_t item = get_global_id(0);
    Visit visit;
    visit.tally = tallies + (large ? 0 : 1 + item);
    visit.valences = valences;
    visit.next_valence = next_valence;
    visit.pairs = pairs;
    visit.fills = fills;
    visit.next_chunk = next_chunk;
    for (int kind = 0; kind < KINDS; kind++)
        visit.at[kind] = 0;
    scratch += item * scratch_words;
    // The scratch memory has up to three parts.
    // The first part holds the starts of the vertices. Unless the block is large, the second part is a copy
    // of the block in 16-byte words. The last part has 4 words per corner of the largest vertex.
    uint size = 1u << shift;
    __global uint *starts = (__global uint *)scratch, *next = starts + size + 1;
    scratch += size + 1;
    __global Record *copy = (__global Record *)(scratch + (size & 1 ? 0 : 1));
    visit.scratch = scratch + 1 + (large ? 0 : 2 * (size_t)limit);
    for (;;) {
        uint k = atomic_inc(next_block);
        if (k >= count)
            break;
        uint corners = block_starts[k + 1] - block_starts[k], v = (first + k) << shift;
        if ((corners > limit) != (large != 0))
            continue;
        uint here = MIN(size, vertices - v);
        __global Record *sorted = records + block_starts[k];
        if (large)
            sort_block_in_place(sorted, corners, v, here, starts, next);
        else {
            sort_block(sorted, corners, v, here, starts, copy);
            sorted = copy;
        }
        visit.block = first + k;
        visit.rank = 0;
        for (uint i = 0; i < here; i++)
            visit_vertex(sorted + starts[i], starts[i + 1] - starts[i], &visit, v + i, vertices);
        block_edges[first + k] = visit.rank;
    }
    for (int kind = 0; kind < KINDS; kind++)
        close_list(&visit, kind);
}
