// Find faces that are certainly culled and invisible in a view, using their bounding spheres.
// This test reads fewer bytes than projecting a face, and takes a tenth of the arithmetic.
// Margins for rounding errors ensure that every face that passes the official tests is kept.
//
// `bounds` has four rows of `stride` words: x, y and z of the centroid, and one word with two halves.
// The halves are the largest distance of a corner from the centroid, and the inradius.
// The two halves are numbers rounded up to the upper 16 bits of a float.

#if LANES == 8
#define HERE(p) (*(__global loose_float8 *)(p)) // values of consecutive faces
#define WORD_HERE(p) (*(__global loose_int8 *)(p))
#define AS_WORD as_int8
#define AS_REAL as_float8
#else
#define HERE(p) (*(p))
#define WORD_HERE(p) (*(__global int *)(p))
#define AS_WORD as_int
#define AS_REAL as_float
#endif

mask upper_half(real x) { return (AS_WORD(x * 1.0001f) + 0xffff) & (int)0xffff0000; }

// This kernel runs once per asset.
__kernel void bound_faces(__global const float *positions, __global const uint *indices,
                          __global float *bounds, uint stride, uint count)
{
    size_t first = get_global_id(0) * LANES;
    if (first >= count)
        return;
    size_t rows[LANES];
    consecutive(first, count, rows);
    vec3 p[3];
    corners_of(rows, positions, indices, p);
    vec3 center = center_of(p[0], p[1], p[2]);
    real radius = (real)0.0f;
    for (int k = 0; k < 3; k++)
        radius = greater(radius, length3(sub3(p[k], center)));
    vec3 e1 = sub3(p[1], p[0]), e2 = sub3(p[2], p[0]);
    real around = length3(e1) + length3(e2) + length3(sub3(p[2], p[1]));
    real inradius = around > 0.0f ? length3(cross3(e1, e2)) / around : (real)0.0f;
    bounds += first;
    HERE(bounds) = center.x;
    HERE(bounds + stride) = center.y;
    HERE(bounds + 2 * (size_t)stride) = center.z;
    mask low = upper_half(inradius) >> 16;
    WORD_HERE(bounds + 3 * (size_t)stride) = upper_half(radius) | (low & 0xffff);
}

#if LANES == 8
// Spheres around groups of FACE_GROUP consecutive faces, in the layout of `bounds`.
// The inradius of a group is the largest inradius of its faces.
__kernel void bound_groups(__global const float *bounds, __global float *groups, uint stride,
                           uint group_stride, uint count)
{
    size_t g = get_global_id(0), begin = g * FACE_GROUP, end = begin + FACE_GROUP < count ? begin + FACE_GROUP : count;
    if (begin >= count)
        return;
    __global const float *x = bounds, *y = x + stride, *z = y + stride;
    __global const uint *radii = (__global const uint *)(z + stride);
    float low[3] = {x[begin], y[begin], z[begin]}, high[3] = {x[begin], y[begin], z[begin]};
    for (size_t i = begin; i < end; i++) {
        float here[3] = {x[i], y[i], z[i]};
        for (int k = 0; k < 3; k++) {
            low[k] = here[k] < low[k] ? here[k] : low[k];
            high[k] = here[k] > high[k] ? here[k] : high[k];
        }
    }
    float center[3], radius = 0.0f;
    uint inradius = 0;
    for (int k = 0; k < 3; k++)
        center[k] = 0.5f * low[k] + 0.5f * high[k];
    for (size_t i = begin; i < end; i++) {
        float dx = x[i] - center[0], dy = y[i] - center[1], dz = z[i] - center[2];
        float reach = sqrt(dx * dx + dy * dy + dz * dz) + as_float(radii[i] & 0xffff0000);
        radius = reach > radius ? reach : radius;
        inradius = max(inradius, radii[i] & 0xffff);
    }
    for (int k = 0; k < 3; k++)
        groups[g + k * (size_t)group_stride] = center[k];
    ((__global int *)groups)[g + 3 * (size_t)group_stride] = upper_half((real)radius).s0 | (int)inradius;
}
#endif

// Returns which of LANES consecutive spheres, from `first` on, may be kept.
// The spheres belong to faces or to groups of faces.
// A centroid may lie up to `depth_growth` radii behind the centre of the sphere.
// NaN is kept.
mask may_be_kept(__constant View *view, __global const float *bounds, uint stride, size_t first,
                 float depth_growth)
{
    __constant Limits *limits = &view->limits;
    __constant float *m = view->world_to_camera, *sides = limits->sides;
    bounds += first;
    real cx = HERE(bounds), cy = HERE(bounds + stride), cz = HERE(bounds + 2 * (size_t)stride);
    real x = MAD(cx, (real)m[0], MAD(cy, (real)m[1], MAD(cz, (real)m[2], (real)m[3])));
    real y = MAD(cx, (real)m[4], MAD(cy, (real)m[5], MAD(cz, (real)m[6], (real)m[7])));
    real z = MAD(cx, (real)m[8], MAD(cy, (real)m[9], MAD(cz, (real)m[10], (real)m[11])));
    mask radii = WORD_HERE(bounds + 3 * (size_t)stride);
    real radius = AS_REAL(radii & (int)0xffff0000) + limits->rounding, growth = radius * limits->growth;
    mask beside = (x + growth < z * sides[0]) | (x - growth > z * sides[1]) |
                  (y + growth < z * sides[2]) | (y - growth > z * sides[3]);
#if CORNERS_MAY_BE_BEHIND && !ENGINE
    // A corner behind the camera is mirrored to an arbitrary position.
    real nearest = z - radius;
    mask before = nearest > 0.1f * (magnitude(x) + magnitude(y) + 1.5f * radius);
    beside &= before;
#if SMALL_IS_DROPPED
    // The projection magnifies lengths, such as the inradius, by at most focal |p| / z^2.
    // Faces with a projected inradius below 1 sample are dropped.
    real inradius = AS_REAL(radii << 16) + limits->rounding;
    real most = inradius * limits->focal * (length3((vec3){x, y, z}) + radius);
    beside |= before & (most < 0.99f * nearest * nearest);
#endif
#endif
    return !((z + radius * depth_growth < limits->nearest) | beside);
}
