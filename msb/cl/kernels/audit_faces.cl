// Properties of single faces, and sums over components.

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

#ifdef __clang__
#define SQUARE_ROOT(x) __builtin_sqrt(x) // compiles to one instruction; PoCL's function would be a call
#else
#define SQUARE_ROOT(x) sqrt(x)
#endif

// The area is half the norm of the cross product.
// Each operation must round as in NumPy, so multiplications and additions are not fused.
double face_area(__global const COORDINATE *p, __global const COORDINATE *q, __global const COORDINATE *r)
{
#pragma OPENCL FP_CONTRACT OFF
    double a0 = (double)q[0] - (double)p[0], a1 = (double)q[1] - (double)p[1], a2 = (double)q[2] - (double)p[2];
    double b0 = (double)r[0] - (double)p[0], b1 = (double)r[1] - (double)p[1], b2 = (double)r[2] - (double)p[2];
    double x = a1 * b2 - a2 * b1, y = a2 * b0 - a0 * b2, z = a0 * b1 - a1 * b0;
    return 0.5 * SQUARE_ROOT(x * x + y * y + z * z);
}

// Meshes have few large components, and usually a single very large component.
// Each work-item counts in a private table.
// If two components need the same slot of the table, the count of the first component is added to the shared
// `sizes`.
#define TABLE 64

#define SOON 12 // number of faces to prefetch ahead, so that their vertices and components are already cached

// For each face, write the area, and write the lowest face of the component to `parents`. An area that is not
// finite is written as 0. Write the initial state for uniting boundary edges as well. All elements of `sizes`
// are initially zero. For each work-item, `samples` gets the number of zero-area faces with distinct
// vertices, and the first of these faces. The same two values follow for faces with non-finite area.
__kernel void measure_faces(__global const COORDINATE *restrict points, __global const uint *restrict faces,
    __global double *restrict areas, __global uint *parents, __global uint *sizes, __global uint *restrict rims,
    __global uint *restrict samples, uint face_count, uint chunk)
{
    size_t item = get_global_id(0);
    uint from = MIN((ulong)face_count, item * (ulong)chunk), to = MIN(face_count, from + chunk);
    uint keys[TABLE], counts[TABLE], zeros = 0, strange = 0;
    for (int i = 0; i < TABLE; i++)
        keys[i] = counts[i] = 0;
    samples += 2 * (SAMPLES + 1) * item;
    for (uint f = from; f < to; f++) {
        uint soon = MIN(f + SOON, to - 1);
        PREFETCH(parents + parents[soon]);
        for (int k = 0; k < 3; k++)
            PREFETCH(points + 3 * (size_t)faces[3 * (size_t)soon + k]);
        __global const uint *face = faces + 3 * (size_t)f;
        uint a = face[0], b = face[1], c = face[2];
        double area = face_area(points + 3 * (size_t)a, points + 3 * (size_t)b, points + 3 * (size_t)c);
        int proper = a != b && b != c && a != c;
        if (!(area <= DBL_MAX)) {
            area = 0;
            if (strange < SAMPLES)
                samples[SAMPLES + 2 + strange] = f;
            strange++;
        } else if (area == 0 && proper) {
            if (zeros < SAMPLES)
                samples[1 + zeros] = f;
            zeros++;
        }
        areas[f] = area;
        rims[f] = f;
        if (!proper)
            continue;
        uint root = find_root(parents, f), slot = root % TABLE;
        parents[f] = root;
        if (keys[slot] != root) {
            if (counts[slot])
                atomic_add(sizes + keys[slot], counts[slot]);
            PREFETCH(sizes + root);
            keys[slot] = root;
            counts[slot] = 0;
        }
        counts[slot]++;
    }
    for (int i = 0; i < TABLE; i++)
        if (counts[i])
            atomic_add(sizes + keys[i], counts[i]);
    samples[0] = zeros;
    samples[SAMPLES + 1] = strange;
}

// Find the component with the most faces. Among equal counts, the larger area wins, then the lowest face
// index. Return the size and area of this component, the number of single-face components, and the total
// area. One work-item adds all areas in face order. Rounding is monotone, so the sum over some faces never
// exceeds the sum over all faces.
__kernel void sum_largest(__global const double *restrict areas, __global const uint *restrict parents,
    __global const uint *restrict sizes, __global double *restrict sums, __global uint *restrict counts,
    __global double *restrict added, uint face_count)
{
    uint most = 0, alone = 0, candidates = 0, largest = NOBODY;
    for (uint f = 0; f < face_count; f++) {
        most = MAX(most, sizes[f]);
        alone += sizes[f] == 1;
    }
    for (uint f = 0; f < face_count; f++)
        candidates += sizes[f] == most;
    volatile double best = 0, total = 0; // volatile keeps Intel's compiler from reordering the additions
    if (most > 0 && candidates == 1) { // the usual case needs no lookup
        for (uint f = 0; f < face_count; f++)
            largest = sizes[f] == most ? f : largest;
        for (uint f = 0; f < face_count; f++) {
            best += parents[f] == largest ? areas[f] : 0.0;
            total += areas[f];
        }
    } else if (most > 0) {
        for (uint f = 0; f < face_count; f++) {
            uint root = parents[f];
            if (sizes[root] == most)
                sums[root] = (root == f ? 0 : sums[root]) + areas[f];
            total += areas[f];
        }
        for (uint f = 0; f < face_count; f++)
            if (sizes[f] == most && sums[f] > best)
                best = sums[f];
    }
    counts[0] = most;
    counts[1] = alone;
    added[0] = best;
    added[1] = total;
}
