// Code shared by the splatting kernels of all methods.
// The shared code covers the view, vector operations in the official order, and operations on lanes. Code
// with lanes serves both kernel styles, so a method needs only one coverage function.
//
// Only the operation MAD is fused.
// Depth keys, culling tests, tile rectangles and inside tests must round as in the official kernels.
// By default the compiler decides about fusing, and devices differ.
#pragma OPENCL FP_CONTRACT OFF

#define MIN_ALPHA (1.0f / 255.0f)
#define MIN_TRANSMITTANCE 1e-4f

// Limits for bounding spheres, with slack for rounding errors (see splat_bounds.cl).
typedef struct {
    float nearest;      // minimum depth of the centre of a sphere, moved away by depth_growth radii
    float depth_growth;
    float sides[4];     // x / z of the left and right edges of the raster, y / z of the upper and lower edges
    // a sphere is outside if its centre lies more than this number of radii outside an edge of the raster
    float growth;
    float rounding;     // rounding error of coordinates in camera space
    float focal;        // focal lengths in samples
} Limits;

// Every member has four bytes; the layout matches VIEW in msb/render/splat/view.py.
typedef struct {
    float world_to_camera[12]; // rows of W, for column vectors
    float full[16];            // P W
    float center[3];           // position of the camera in world space
    float tan_fov[2];
    float shift[2];            // offset of the principal point from the middle of the raster, in samples
    uint width, height;        // size of the raster in samples
    uint columns, rows;        // numbers of tiles
    uint degree;               // maximum degree of the evaluated spherical harmonics
    uint rest_stride;          // floats per row of f_rest: red, green, blue of coefficient 1, 2 and so on
    // Three rules say which tiles list a face.
    // TILES_REACHED lists a face in all tiles that it reaches.
    // TILES_OFFICIAL uses the official tiles of the face.
    // TILES_BOTH uses the official tiles that the face reaches.
    // TILES_OFFICIAL and TILES_BOTH give the same image.
    // msb/render/splat/pipeline.py defines these constants.
    uint tile_rule;
    Limits limits;
#ifdef OWN_MEMBERS
    struct {
        OWN_MEMBERS // members of the method, from `own` in its module `native` (msb/render/splat/model.py)
    } own;
#endif
} View;

// The model.
// A triangle soup stores corners as rows of `positions` and does not use `indices`.
typedef struct {
    __global const float *positions;
    __global const uint *indices;
    __global const float *coverage; // rows of COVERAGE floats, one row per face or vertex
    __global const float *f_dc, *f_rest;
} Source;

// ---- lanes: 8 faces, or 8 samples of a row, on a CPU; 1 on a GPU. Never 16: docs/opencl.md.

#if LANES == 8
#include "lanes.cl"
typedef float8 real;
typedef int8 mask;
#define ANY(m) any8(m)
#define LANE_INDEX ((float8)(0, 1, 2, 3, 4, 5, 6, 7))
// If an argument is NaN, the first argument is returned.
#define lesser(a, b) min8(b, a)
#define greater(a, b) max8(b, a)
#define lesser_of(a, b) min8i(b, a)
#define greater_of(a, b) max8i(b, a)
#define root(a) sqrt8(a)

real MAD(real a, real b, real c);

// Adding 1.5 * 2^23 leaves the rounded integer in the low bits.
// The addition avoids the conversion instruction, which PoCL emits separately for each lane.
#define MAGIC 12582912.0f

// 2^x for -126 <= x <= 127, by a minimax fit on [-0.5, 0.5]; the relative error is 2e-9 before rounding.
real exp2_fast(real x)
{
    real shifted = x + MAGIC;
    real f = x - (shifted - MAGIC);
    real p = MAD(f, (real)1.5345812e-4f, (real)1.3399931e-3f);
    p = MAD(p, f, (real)9.6184891e-3f);
    p = MAD(p, f, (real)5.5503286e-2f);
    p = MAD(p, f, (real)2.4022646e-1f);
    p = MAD(p, f, (real)6.9314718e-1f);
    p = MAD(p, f, (real)1.0f);
    return p * as_float8((as_int8(shifted) + 127) << 23);
}

// log2(x) for positive normal x, by a minimax fit in odd powers of (m - 1) / (m + 1) with m in [sqrt 1/2,
// sqrt 2).
// The relative error is 7e-10 before rounding.
real log2_fast(real x)
{
    int8 bits = as_int8(x);
    int8 exponent = (bits - 0x3f3504f3) >> 23;
    real m = as_float8(bits - (exponent << 23));
    real s = (m - 1.0f) / (m + 1.0f), t = s * s;
    real p = MAD(t, (real)0.43173578f, (real)0.5767144f);
    p = MAD(p, t, (real)0.96179885f);
    p = MAD(p, t, (real)2.8853900f);
    return MAD(p, s, as_float8(exponent + 0x4b400000) - MAGIC);
}
#else
typedef float real;
typedef int mask;
#define ANY(m) (m)
#define LANE_INDEX 0.0f
#define lesser(a, b) fmin(a, b)
#define greater(a, b) fmax(a, b)
#define lesser_of(a, b) min(a, b)
#define greater_of(a, b) max(a, b)
#define magnitude(a) fabs(a)
#define root(a) sqrt(a)
#define exp2_fast(x) exp2(x)
#define log2_fast(x) log2(x)
#endif

// a b + c where rounding does not matter; fused if the device has such an instruction.
real MAD(real a, real b, real c)
{
#pragma OPENCL FP_CONTRACT ON
    return a * b + c;
}

// ---- vectors of lanes; sums run from the first component to the last

typedef struct {
    real x, y;
} vec2;

typedef struct {
    real x, y, z;
} vec3;

typedef struct {
    mask x0, y0, x1, y1;
} Box; // sample boxes include both ends, tile boxes exclude the high ends

vec2 sub2(vec2 a, vec2 b) { return (vec2){a.x - b.x, a.y - b.y}; }
vec2 add2(vec2 a, vec2 b) { return (vec2){a.x + b.x, a.y + b.y}; }
vec2 mul2(vec2 a, real s) { return (vec2){a.x * s, a.y * s}; }
real dot2(vec2 a, vec2 b) { return a.x * b.x + a.y * b.y; }
real cross2(vec2 a, vec2 b) { return a.x * b.y - a.y * b.x; }
real length2(vec2 a) { return root(dot2(a, a)); }

vec3 sub3(vec3 a, vec3 b) { return (vec3){a.x - b.x, a.y - b.y, a.z - b.z}; }
vec3 add3(vec3 a, vec3 b) { return (vec3){a.x + b.x, a.y + b.y, a.z + b.z}; }
vec3 mul3(vec3 a, real s) { return (vec3){a.x * s, a.y * s, a.z * s}; }
vec3 div3(vec3 a, real s) { return (vec3){a.x / s, a.y / s, a.z / s}; }
real dot3(vec3 a, vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
real length3(vec3 a) { return root(dot3(a, a)); }

vec3 cross3(vec3 a, vec3 b)
{
    return (vec3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

vec3 center_of(vec3 a, vec3 b, vec3 c) { return div3(add3(add3(a, b), c), (real)3.0f); }

real affine(__constant float *row, vec3 p)
{
    return row[0] * p.x + row[1] * p.y + row[2] * p.z + row[3];
}

real linear(__constant float *row, vec3 v) { return row[0] * v.x + row[1] * v.y + row[2] * v.z; }

vec3 to_camera(__constant View *view, vec3 p)
{
    __constant float *m = view->world_to_camera;
    return (vec3){affine(m, p), affine(m + 4, p), affine(m + 8, p)};
}

vec3 rotate_to_camera(__constant View *view, vec3 v)
{
    __constant float *m = view->world_to_camera;
    return (vec3){linear(m, v), linear(m + 4, v), linear(m + 8, v)};
}

// ---- members of rows of `width` floats

// Returns LANES rows from `first` on; the last of `count` rows is repeated.
void consecutive(size_t first, size_t count, size_t *rows)
{
    for (uint k = 0; k < LANES; k++)
        rows[k] = first + k < count ? first + k : count - 1;
}

#if LANES == 8
real load(__global const float *p, const size_t *rows, uint width, uint member)
{
    p += member;
    return (real)(p[rows[0] * width], p[rows[1] * width], p[rows[2] * width], p[rows[3] * width],
                  p[rows[4] * width], p[rows[5] * width], p[rows[6] * width], p[rows[7] * width]);
}

// Eight consecutive members.
void load_eight(__global const float *p, const size_t *rows, uint width, real *out)
{
    real r0 = LOAD(p + rows[0] * width, 0), r1 = LOAD(p + rows[1] * width, 0);
    real r2 = LOAD(p + rows[2] * width, 0), r3 = LOAD(p + rows[3] * width, 0);
    real r4 = LOAD(p + rows[4] * width, 0), r5 = LOAD(p + rows[5] * width, 0);
    real r6 = LOAD(p + rows[6] * width, 0), r7 = LOAD(p + rows[7] * width, 0);
    TRANSPOSE(r0, r1, r2, r3, r4, r5, r6, r7);
    out[0] = r0;
    out[1] = r1;
    out[2] = r2;
    out[3] = r3;
    out[4] = r4;
    out[5] = r5;
    out[6] = r6;
    out[7] = r7;
}

// Returns the first `count` members.
void load_members(__global const float *p, const size_t *rows, uint width, uint count, real *out)
{
    uint rest = count % 8, whole = count - rest;
    for (uint k = 0; k < whole; k += 8)
        load_eight(p + k, rows, width, out + k);
    if (whole && rest > 2) // read the last eight, which overlap the previous eight
        load_eight(p + count - 8, rows, width, out + count - 8);
    else
        for (uint k = whole; k < count; k++)
            out[k] = load(p, rows, width, k);
}

void prefetch_row(__global const float *p, size_t row, uint width)
{
    p += row * width;
    for (uint k = 0; k < width; k += 16)
        PREFETCH_FAR(p + k);
    PREFETCH_FAR(p + width - 1);
}
#else
real load(__global const float *p, const size_t *rows, uint width, uint member)
{
    return p[rows[0] * width + member];
}

void load_members(__global const float *p, const size_t *rows, uint width, uint count, real *out)
{
    for (uint k = 0; k < count; k++)
        out[k] = p[rows[0] * width + k];
}
#endif

vec3 load3(__global const float *p, const size_t *rows)
{
    return (vec3){load(p, rows, 3, 0), load(p, rows, 3, 1), load(p, rows, 3, 2)};
}

// The fma() of PoCL is a function call.
// But a b + c compiles to an FMA instruction if the processor has this instruction.
#ifdef __FMA__
#define exact_fma MAD
#else
#define exact_fma fma
#endif

// Computes ((ndc + 1) size - 1) / 2, which the official code evaluates in double and rounds once.
// Pixel i has its centre at the integer i.
// Here the result is the unevaluated sum of two floats: product and sum with their rounding errors.
// The sum rounds to the same float as the official result, even on devices without double precision
// (tests/render/test_splatting.py).
real to_sample(real ndc, uint size)
{
    real n = (real)(float)size, m = n - 1.0f;
    real product = ndc * n, product_error = exact_fma(ndc, n, -product);
    real sum = product + m, part = sum - product;
    real sum_error = (product - (sum - part)) + (m - part);
    real whole = sum + (product_error + sum_error);
    return (magnitude(sum) < 1e30f ? whole : sum) * 0.5f;
}

// The result is valid for 0 <= x < 2^22.
#if LANES == 8
real floor_small(real x)
{
    real r = (x + MAGIC) - MAGIC;
    return r > x ? r - 1.0f : r;
}
mask integer_of(real whole) { return as_int8(whole + MAGIC) - 0x4b400000; }
#else
#define floor_small(x) floor(x)
#define integer_of(x) ((int)(x))
#endif

// Converts to an integer as CUDA does: rounds towards zero, saturates, and maps NaN to 0. The result is at
// most `limit`.
mask tile_number(real value, uint limit)
{
    real clamped = value > 0.0f ? value : (real)0.0f;
    clamped = clamped < (float)limit ? clamped : (real)(float)limit;
    return integer_of(floor_small(clamped));
}

// Like `tile_number`, but rounds up to an integer.
mask tile_after(real value, uint limit)
{
    real clamped = value > 0.0f ? value : (real)0.0f;
    clamped = clamped < (float)limit ? clamped : (real)(float)limit;
    real whole = floor_small(clamped);
    return integer_of(whole < clamped ? whole + 1.0f : whole);
}

// Returns the samples of [low, high], clamped to the raster. If a bound is NaN, the box contains all samples.
Box box_of(vec2 low, vec2 high, __constant View *view)
{
    real w = (real)((float)view->width - 1.0f), h = (real)((float)view->height - 1.0f), zero = (real)0.0f;
    Box box;
    // If the lower bound lies beyond the raster, the box is empty.
    real x0 = low.x > 0.0f ? (low.x < w ? low.x : w + 1.0f) : zero;
    real y0 = low.y > 0.0f ? (low.y < h ? low.y : h + 1.0f) : zero;
    box.x0 = integer_of(floor_small(x0 + 0.999f));
    box.y0 = integer_of(floor_small(y0 + 0.999f));
    real x1 = high.x < w ? (high.x >= 0.0f ? high.x : (real)-1.0f) : w;
    real y1 = high.y < h ? (high.y >= 0.0f ? high.y : (real)-1.0f) : h;
    box.x1 = integer_of(floor_small(x1 + 1.0f) - 1.0f);
    box.y1 = integer_of(floor_small(y1 + 1.0f) - 1.0f);
    return box;
}

// The struct is aligned, because the record of a face is stored in groups of eight words.
#define BY_EIGHTS __attribute__((aligned(32)))

// ---- address space of a face during blending; the face is not copied to private memory

#if LANES == 8
#define FACE_POINTER __global const struct Face *
#else
#define FACE_POINTER __local const struct Face *
#endif
