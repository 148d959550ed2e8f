// Operations on eight lanes for CPU kernels, which use only operators, ternaries and dereferenced vectors.
//
// The PoCL wheel does not inline OpenCL functions and passes vectors to them through memory.
// The reason is that PoCL's library and the kernels use different instruction sets.
// Therefore these kernels use only builtins of the compiler.
// 64-bit vectors have four lanes, because eight would take 512 bits (docs/opencl.md).

typedef float8 __attribute__((aligned(4))) loose_float8;
typedef int8 __attribute__((aligned(4))) loose_int8;
#define LOAD(p, i) (((__global const loose_float8 *)(p))[i])
#define LOAD_INT(p) (*(__global const loose_int8 *)(p))
#define PICK(v, l) (((const int *)&(v))[l])
#define PICK_F(v, l) (((const float *)&(v))[l])

#ifdef __clang__
#define TO_INT(x) __builtin_convertvector(x, int8)
#define TO_FLOAT(x) __builtin_convertvector(x, float8)
#define TO_INT4(x) __builtin_convertvector(x, int4)
#define TO_LONG4(x) __builtin_convertvector(x, long4)
#define LOWEST_BIT(x) __builtin_ctz(x)
#define PREFETCH(p) __builtin_prefetch(p)
// Prefetch into the second-level cache only.
// The first-level cache has too few slots for all prefetched lines, so its loads would be delayed.
#define PREFETCH_FAR(p) __builtin_prefetch(p, 0, 2)
#else
#define TO_INT(x) convert_int8(x)
#define TO_FLOAT(x) convert_float8(x)
#define TO_INT4(x) convert_int4(x)
#define TO_LONG4(x) convert_long4(x)
#define LOWEST_BIT(x) (31 - clz((x) & -(x)))
#define PREFETCH(p)
#define PREFETCH_FAR(p)
#endif

float8 min8(float8 a, float8 b) { return a < b ? a : b; }
float8 max8(float8 a, float8 b) { return a > b ? a : b; }
int8 min8i(int8 a, int8 b) { return a < b ? a : b; }
int8 max8i(int8 a, int8 b) { return a > b ? a : b; }
float8 magnitude(float8 a) { return as_float8(as_int8(a) & 0x7fffffff); }

// PoCL calls its sqrt function for each lane; this single instruction rounds identically.
#if defined(__clang__) && defined(__AVX__)
float8 sqrt8(float8 a)
{
    typedef float __attribute__((vector_size(32))) eight_floats;
    union {
        float8 ours;
        eight_floats theirs;
    } root = {a};
    root.theirs = __builtin_ia32_sqrtps256(root.theirs);
    return root.ours;
}
#else
#define sqrt8(a) sqrt(a)
#endif

#ifdef __SSE4_1__
#if __has_builtin(__builtin_elementwise_floor)
#define FLOOR(x) __builtin_elementwise_floor(x)
#endif
#endif

// Returns the numbers at the indices `i` in an array of 16 numbers.
#if defined(__clang__) && defined(__AVX2__)
int8 one_of_16(__global const int *p, int8 i)
{
    typedef int __attribute__((vector_size(32))) eight_ints;
    union {
        int8 ours;
        eight_ints theirs;
    } at = {i}, low = {LOAD_INT(p)}, high = {LOAD_INT(p + 8)};
    low.theirs = __builtin_ia32_permvarsi256(low.theirs, at.theirs);
    high.theirs = __builtin_ia32_permvarsi256(high.theirs, at.theirs);
    return i < 8 ? low.ours : high.ours;
}
#else
int8 one_of_16(__global const int *p, int8 i)
{
    return (int8)(p[i.s0], p[i.s1], p[i.s2], p[i.s3], p[i.s4], p[i.s5], p[i.s6], p[i.s7]);
}
#endif

int or8(int8 v)
{
    int4 low4 = v.lo | v.hi;
    int2 low2 = low4.lo | low4.hi;
    return low2.x | low2.y;
}

int any8(int8 mask)
{
    ulong4 q = as_ulong4(mask);
    return ((q.x | q.y) | (q.z | q.w)) != 0;
}

// Returns a number with bit l set if lane l of the mask is set.
int bits8(int8 mask) { return or8(mask & (int8)(1, 2, 4, 8, 16, 32, 64, 128)); }

// Transposes eight rows of eight words.
#define TRANSPOSE(a, b, c, d, e, f, g, h)                                                                       \
    {                                                                                                           \
        float8 p0 = (float8)(a.s0, b.s0, a.s1, b.s1, a.s4, b.s4, a.s5, b.s5);                                   \
        float8 p1 = (float8)(a.s2, b.s2, a.s3, b.s3, a.s6, b.s6, a.s7, b.s7);                                   \
        float8 p2 = (float8)(c.s0, d.s0, c.s1, d.s1, c.s4, d.s4, c.s5, d.s5);                                   \
        float8 p3 = (float8)(c.s2, d.s2, c.s3, d.s3, c.s6, d.s6, c.s7, d.s7);                                   \
        float8 p4 = (float8)(e.s0, f.s0, e.s1, f.s1, e.s4, f.s4, e.s5, f.s5);                                   \
        float8 p5 = (float8)(e.s2, f.s2, e.s3, f.s3, e.s6, f.s6, e.s7, f.s7);                                   \
        float8 p6 = (float8)(g.s0, h.s0, g.s1, h.s1, g.s4, h.s4, g.s5, h.s5);                                   \
        float8 p7 = (float8)(g.s2, h.s2, g.s3, h.s3, g.s6, h.s6, g.s7, h.s7);                                   \
        float8 q0 = (float8)(p0.s01, p2.s01, p0.s45, p2.s45), q1 = (float8)(p0.s23, p2.s23, p0.s67, p2.s67);    \
        float8 q2 = (float8)(p1.s01, p3.s01, p1.s45, p3.s45), q3 = (float8)(p1.s23, p3.s23, p1.s67, p3.s67);    \
        float8 q4 = (float8)(p4.s01, p6.s01, p4.s45, p6.s45), q5 = (float8)(p4.s23, p6.s23, p4.s67, p6.s67);    \
        float8 q6 = (float8)(p5.s01, p7.s01, p5.s45, p7.s45), q7 = (float8)(p5.s23, p7.s23, p5.s67, p7.s67);    \
        a = (float8)(q0.lo, q4.lo);                                                                             \
        b = (float8)(q1.lo, q5.lo);                                                                             \
        c = (float8)(q2.lo, q6.lo);                                                                             \
        d = (float8)(q3.lo, q7.lo);                                                                             \
        e = (float8)(q0.hi, q4.hi);                                                                             \
        f = (float8)(q1.hi, q5.hi);                                                                             \
        g = (float8)(q2.hi, q6.hi);                                                                             \
        h = (float8)(q3.hi, q7.hi);                                                                             \
    }
