// DiffSoup: computations that both kernel styles share, for one pixel or for eight pixels.
//
// If WIDE is 1, a `real` is a float8 for eight neighbouring pixels.
// CPU compilers do not vectorise loops with a data-dependent length.
// If WIDE is 0, a `real` is a float.
// The operations and their order are equal, so both styles give equal bits on one device.
//
// Before the decoder, products and sums must not be fused.
// The rounding of these operations decides which triangle covers a pixel.
//
// Operators replace OpenCL functions: ?: replaces select, and casts replace vload8.
// PoCL's CPU driver compiles select and vload8 as library calls. A call takes several times as long as one
// instruction. The defines are WIDE, TEXEL (float or uchar) and TEXEL_SCALE (1 or 255). The parameter `side`
// is 2^level of the lattices.
#pragma OPENCL FP_CONTRACT OFF

#define FEATURES 7
#define HARMONICS 9
#define INPUTS 16
#define SAMPLES(side) ((size_t)((side) + 1) * ((side) + 2) / 2)

#if WIDE
typedef float8 real;
typedef int8 whole;
#define TO_WHOLE convert_int8
#define TO_REAL convert_float8
#define AS_WHOLE as_int8
#define AS_REAL as_float8
#else
typedef float real;
typedef int whole;
#define TO_WHOLE convert_int
#define TO_REAL convert_float
#define AS_WHOLE as_int
#define AS_REAL as_float
#endif

#define LOWER(a, b) ((a) < (b) ? (a) : (b))
#define HIGHER(a, b) ((a) > (b) ? (a) : (b))

#if TEXEL_SCALE == 1
#define DECODED(x) (x)
#else
// The division is correctly rounded.
// A product with 1/255 would differ in the last bit.
#define DECODED(x) ((x) / (float)TEXEL_SCALE)
#endif

// The layout of the record that the host writes for each frame, all float32.
// The values are offsets into one buffer.
#define MVP 0
#define INVERSE 16
#define BACKGROUND 32

typedef struct {
    real b0, b1; // barycentric coordinates of corners 0 and 1, linear in world space
    real ndc;    // z / w
    real w;      // the camera's z
    whole valid; // the point is inside (edges included), and between the near and the far plane
} Fragment;

// Returns the point where the ray of a pixel with NDC centre (u, v) meets a triangle.
// The corners p0, p1 and p2 are in clip coordinates.
static Fragment fragment_at(real u, float v, float4 p0, float4 p1, float4 p2)
{
    float qy0 = p0.y - v * p0.w, qy1 = p1.y - v * p1.w, qy2 = p2.y - v * p2.w;
    real qx0 = p0.x - u * p0.w, qx1 = p1.x - u * p1.w, qx2 = p2.x - u * p2.w;
    real a0 = qx1 * qy2 - qy1 * qx2;
    real a1 = qx2 * qy0 - qy2 * qx0;
    real a2 = qx0 * qy1 - qy0 * qx1;
    real k = 1.0f / (a0 + a1 + a2);
    Fragment f;
    f.b0 = a0 * k;
    f.b1 = a1 * k;
    // An area of 0 needs no test, because b0 and b1 become infinite or NaN, which counts as outside.
    f.valid = (f.b0 >= 0.0f) & (f.b1 >= 0.0f) & (f.b0 + f.b1 <= 1.0f);
    real b2 = 1.0f - f.b0 - f.b1;
    real z = f.b0 * p0.z + f.b1 * p1.z + b2 * p2.z;
    f.w = f.b0 * p0.w + f.b1 * p1.w + b2 * p2.w;
    f.ndc = z / f.w;
    f.valid &= (f.ndc >= -1.0f) & (f.ndc <= 1.0f);
    return f;
}

// The three lattice nodes around a point of a face, and their weights.
// Lattice node 1 always follows node 0 in memory.
typedef struct {
    whole node0, node2;
    real w0, w1, w2;
} Cell;

// The coordinates b0 and b1 must not be negative, so that conversion to int rounds down.
static Cell cell_at(real b0, real b1, int side)
{
    real u = b0 * (float)side, v = b1 * (float)side;
    whole end = side - 1, x = TO_WHOLE(u), y = TO_WHOLE(v);
    x = LOWER(x, end);
    end -= x;
    y = LOWER(y, end);
    u -= TO_REAL(x);
    v -= TO_REAL(y);
    whole flip = u + v > 1.0f;
    Cell c;
    c.w0 = flip ? 1.0f - v : u;
    c.w1 = flip ? 1.0f - u : v;
    c.w2 = 1.0f - c.w0 - c.w1;
    // Node (x, y) is sample s (s + 1) / 2 + y with s = x + y.
    whole s = x + y + 1;
    c.node0 = s * (s + 1) / 2 + y;
    whole y2 = y + 1;
    y2 = LOWER(y2, end);
    whole s2 = x + 1 + y2;
    c.node2 = flip ? s2 * (s2 + 1) / 2 + y2 : c.node0 - s;
    return c;
}

// Unit vectors from the surface towards the camera: near point minus far point of the pixel's ray.
static void towards_camera(real u, float v, __global const float *m, real *x, real *y, real *z)
{
#define ROW(r) (m[4 * r] * u + m[4 * r + 1] * v)
    real x0 = ROW(0), y0 = ROW(1), z0 = ROW(2), w0 = ROW(3);
#undef ROW
    real near = 1.0f / (w0 - m[14] + m[15]), far = 1.0f / (w0 + m[14] + m[15]);
    real dx = (x0 - m[2] + m[3]) * near - (x0 + m[2] + m[3]) * far;
    real dy = (y0 - m[6] + m[7]) * near - (y0 + m[6] + m[7]) * far;
    real dz = (z0 - m[10] + m[11]) * near - (z0 + m[10] + m[11]) * far;
    real length = 1.0f / sqrt(dx * dx + dy * dy + dz * dz);
    *x = dx * length;
    *y = dy * length;
    *z = dz * length;
}

// Real spherical harmonics up to degree 2, with the signs of 3D Gaussian Splatting.
static void harmonics(real x, real y, real z, real *e)
{
    const float c1 = 0.4886025119029199f, c2 = 1.0925484305920792f;
    e[0] = (real)(0.28209479177387814f);
    e[1] = -c1 * y;
    e[2] = c1 * z;
    e[3] = -c1 * x;
    e[4] = c2 * (x * y);
    e[5] = -c2 * (y * z);
    e[6] = 0.31539156525252005f * (2.0f * z * z - x * x - y * y);
    e[7] = -c2 * (x * z);
    e[8] = 0.5462742152960396f * (x * x - y * y);
}

// From here on products and sums may be fused, because no decision depends on the rounding.
#pragma OPENCL FP_CONTRACT ON

// exp(x) is accurate to 2 ulp; beyond +-87 the logistic function is constant. exp is implemented here so that
// one pixel and eight pixels give equal bits.
// The scalar and vector functions of a platform may differ.
static real exponential(real x)
{
    const real most = 87.0f, least = -87.0f;
    x = LOWER(x, most);
    x = HIGHER(x, least);
    const float shift = 12582912.0f; // 1.5 * 2^23; adding it leaves the rounded integer in the low bits
    real t = x * 1.44269504f + shift;
    real n = t - shift;
    real r = x - n * 0.693359375f; // ln 2, split into two parts
    r = r + n * 2.12194440e-4f;
    real p = r * (1.0f / 5040) + 1.0f / 720;
    p = p * r + 1.0f / 120;
    p = p * r + 1.0f / 24;
    p = p * r + 1.0f / 6;
    p = p * r + 0.5f;
    p = p * r + 1.0f;
    p = p * r + 1.0f;
    return p * AS_REAL((AS_WHOLE(t) - 0x4b400000 + 127) << 23);
}

// One hidden layer with 16 inputs, 16 outputs and ReLU.
// Eight sums are computed side by side, to hide the latency of each product.
static void hidden_layer(const real *x, __constant const float *weight, __constant const float *bias, real *y)
{
    const real zero = 0.0f;
    for (int o = 0; o < 16; o += 8) {
        __constant const float *w = weight + o * INPUTS;
        real s0 = bias[o], s1 = bias[o + 1], s2 = bias[o + 2], s3 = bias[o + 3];
        real s4 = bias[o + 4], s5 = bias[o + 5], s6 = bias[o + 6], s7 = bias[o + 7];
        for (int i = 0; i < INPUTS; i++) {
            real t = x[i];
            s0 = s0 + t * w[i];
            s1 = s1 + t * w[INPUTS + i];
            s2 = s2 + t * w[2 * INPUTS + i];
            s3 = s3 + t * w[3 * INPUTS + i];
            s4 = s4 + t * w[4 * INPUTS + i];
            s5 = s5 + t * w[5 * INPUTS + i];
            s6 = s6 + t * w[6 * INPUTS + i];
            s7 = s7 + t * w[7 * INPUTS + i];
        }
        y[o] = HIGHER(s0, zero);
        y[o + 1] = HIGHER(s1, zero);
        y[o + 2] = HIGHER(s2, zero);
        y[o + 3] = HIGHER(s3, zero);
        y[o + 4] = HIGHER(s4, zero);
        y[o + 5] = HIGHER(s5, zero);
        y[o + 6] = HIGHER(s6, zero);
        y[o + 7] = HIGHER(s7, zero);
    }
}

// Returns the colour of features and harmonics x[16].
// The array `net` has the weights and biases of the three layers, one after another.
static void decode(const real *x, __constant const float *net, real *color)
{
    real h1[16], h2[16];
    hidden_layer(x, net, net + 256, h1);
    hidden_layer(h1, net + 272, net + 528, h2);
    __constant const float *w = net + 544, *bias = net + 592;
    real s0 = bias[0], s1 = bias[1], s2 = bias[2];
    for (int i = 0; i < 16; i++) {
        s0 = s0 + h2[i] * w[i];
        s1 = s1 + h2[i] * w[16 + i];
        s2 = s2 + h2[i] * w[32 + i];
    }
    real mix = x[3], base = 1.0f - mix;
    color[0] = base * x[0] + mix * (1.0f / (1.0f + exponential(-s0)));
    color[1] = base * x[1] + mix * (1.0f / (1.0f + exponential(-s1)));
    color[2] = base * x[2] + mix * (1.0f / (1.0f + exponential(-s2)));
}

// A feature rounded to the precision of an 8-bit render target.
static real as_target(real feature)
{
    const real zero = 0.0f, one = 1.0f;
    feature = HIGHER(feature, zero);
    feature = LOWER(feature, one);
    return TO_REAL(TO_WHOLE(feature * 255.0f + 0.5f)) / 255.0f;
}

// Files that include this file must set their rule for fused products again.
#pragma OPENCL FP_CONTRACT OFF
