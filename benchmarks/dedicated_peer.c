// What benchmarks/dedicated.py compares the pipeline with: C, OpenMP, AVX2 and FMA.
//
// blend is the blend stage of 2DTS (2D rasterizer, gamma 1) by hand: the same lists, the same faces, the same
// planes. The others move the bytes that a projection must move, and do nothing else.
#include <immintrin.h>
#include <math.h>
#include <stdint.h>
// Whether this processor has what the rest is compiled for.
int can_run(void) { return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"); }
typedef float v8 __attribute__((vector_size(32)));
typedef int32_t i8 __attribute__((vector_size(32)));
typedef long long l4 __attribute__((vector_size(32)));
typedef struct {
    float x[3], y[3], inverse, z[3], normal[3], opacity, limit, color[3];
    int x0, y0, x1, y1, number, unused;
} Face;
static inline int any(i8 m) { l4 q = (l4)m; return (q[0] | q[1] | q[2] | q[3]) != 0; }
static inline v8 all(float s) { return s - (v8){}; }
static inline v8 where(i8 m, v8 a, v8 b) { return (v8)(((i8)a & m) | ((i8)b & ~m)); }
static inline v8 exp2_fast(v8 x) {
    v8 shifted = x + 12582912.0f, f = x - (shifted - 12582912.0f);
    v8 p = f * 1.5345812e-4f + 1.3399931e-3f;
    p = p * f + 9.6184891e-3f; p = p * f + 5.5503286e-2f; p = p * f + 2.4022646e-1f;
    p = p * f + 6.9314718e-1f; p = p * f + 1.0f;
    return p * (v8)(((i8)shifted + 127) << 23);
}
static inline v8 smaller(v8 a, v8 b) { return (v8)_mm256_min_ps((__m256)a, (__m256)b); }
typedef struct { v8 e, a1, a2, alpha; } Sample;
static inline i8 inside(const Face *f, const v8 *x, float y, Sample *s) {
    float y1 = f->y[0] - y, y2 = f->y[1] - y, y3 = f->y[2] - y;
    s->a1 = (x[1] * y3 - y2 * x[2]) * f->inverse;
    s->a2 = (x[2] * y1 - y3 * x[0]) * f->inverse;
    s->e = 1.0f - 3.0f * smaller(smaller(s->a1, s->a2), 1.0f - s->a1 - s->a2);
    return (s->e >= 0.0f) & (s->e <= f->limit);
}
static inline i8 cover(const Face *f, i8 m, Sample *s) {
    v8 g = s->e * s->e * -0.72134752f;
    s->alpha = smaller(all(0.99f), f->opacity * exp2_fast((v8)_mm256_max_ps((__m256)g, (__m256)all(-100))));
    return m & (s->alpha >= 1.0f / 255.0f);
}
typedef struct { v8 t, red, green, blue, z; } State;
static inline void row(State *p, const Face *f, i8 hit, const Sample *s) {
    v8 before = p->t;
    i8 m = hit & (before > 1e-4f);
    v8 w = where(m, s->alpha * before, (v8){});
    p->t = where(m, before * (1.0f - s->alpha), before);
    p->red += f->color[0] * w; p->green += f->color[1] * w; p->blue += f->color[2] * w;
    p->z += ((1.0f - s->a1 - s->a2) * f->z[2] + s->a2 * f->z[1] + s->a1 * f->z[0]) * w;
}
static inline i8 reaches(const Face *f, float left, v8 y) {
    i8 found = ~(i8){};
    float wide = fabsf(f->x[0] - left) + fabsf(f->x[1] - left) + fabsf(f->x[2] - left) + 8;
    float tall = fabsf(f->y[0] - y[0]) + fabsf(f->y[1] - y[0]) + fabsf(f->y[2] - y[0]) + 16;
    float least = (1 - f->limit) / 3 - 1e-4f - 1e-6f * wide * tall * fabsf(f->inverse);
    for (int k = 0; k < 3; k++) {
        int i = k == 2 ? 0 : k + 1, j = k == 0 ? 2 : k - 1;
        float sx = (f->y[i] - f->y[j]) * f->inverse, sy = (f->x[j] - f->x[i]) * f->inverse;
        float most = 7 * fmaxf(sx, 0) + fmaxf(sy, 0);
        v8 at = ((f->x[i] - left) * (f->y[j] - y) - (f->y[i] - y) * (f->x[j] - left)) * f->inverse;
        found &= ~(at + most < least);
    }
    return found;
}
void blend(const uint64_t *starts, const uint32_t *list, const Face *faces, float *planes, int width,
           int height, int columns, int rows) {
    const v8 lane = {0, 1, 2, 3, 4, 5, 6, 7};
    const i8 bit = {1, 2, 4, 8, 16, 32, 64, 128};
#pragma omp parallel for schedule(dynamic, 4)
    for (int tile = 0; tile < columns * rows; tile++) {
        int left = tile % columns * 16, top = tile / columns * 16;
        State state[2][16];
        unsigned alive[2];
        for (int h = 0; h < 2; h++) {
            v8 x = lane + (float)(left + 8 * h);
            alive[h] = left + 8 * h < width ? 0xff : 0;
            if (top + 16 > height) alive[h] &= (1u << (height - top + 1) / 2) - 1;
            for (int r = 0; r < 16; r++) {
                state[h][r] = (State){};
                i8 there = (x < (float)width) & (all(top + r) < (float)height);
                state[h][r].t = where(there, all(1), all(-1));
            }
        }
        for (uint64_t e = starts[tile], end = starts[tile + 1]; e < end && (alive[0] | alive[1]); e++) {
            const Face *f = faces + list[e];
            const char *next = (const char *)(faces + list[e + 4 < end ? e + 4 : end - 1]);
            __builtin_prefetch(next, 0, 2); __builtin_prefetch(next + 64, 0, 2);
            int y0 = (f->y0 > top ? f->y0 - top : 0) / 2, y1 = (f->y1 - top < 15 ? f->y1 - top : 15) / 2;
            if (f->y1 < top || y0 > y1) continue;
            unsigned pairs = (0xffu >> (7 - y1)) & (0xffu << y0);
            for (int h = 0; h < 2; h++) {
                int from = left + 8 * h;
                if (!(alive[h] & pairs) || f->x1 < from || f->x0 > from + 7) continue;
                l4 q = (l4)(reaches(f, from, (float)top + 2.0f * lane) & bit);
                uint64_t b = q[0] | q[1] | q[2] | q[3];
                unsigned todo = alive[h] & pairs & (unsigned)(b | b >> 32);
                v8 x = lane + (float)from, c[3] = {f->x[0] - x, f->x[1] - x, f->x[2] - x};
                for (; todo; todo &= todo - 1) {
                    int k = __builtin_ctz(todo);
                    float y = top + 2 * k;
                    Sample s, u;
                    i8 m = inside(f, c, y, &s), n = inside(f, c, y + 1, &u);
                    if (!any(m | n)) continue;
                    m = cover(f, m, &s), n = cover(f, n, &u);
                    if (!any(m | n)) continue;
                    State *p = &state[h][2 * k];
                    row(p, f, m, &s), row(p + 1, f, n, &u);
                    if (!any((p[0].t > 1e-4f) | (p[1].t > 1e-4f))) alive[h] &= ~(1u << k);
                }
            }
        }
        long stride = 16L * columns, plane = stride * 16 * rows;
        for (int r = 0; r < 16; r++)
            for (int h = 0; h < 2; h++) {
                float *out = planes + (top + r) * stride + left + 8 * h;
                State *p = &state[h][r];
                p->t = where(p->t < 0.0f, -p->t, p->t);
                *(v8 *)out = p->red; *(v8 *)(out + plane) = p->green; *(v8 *)(out + 2 * plane) = p->blue;
                *(v8 *)(out + 3 * plane) = p->t; *(v8 *)(out + 4 * plane) = p->z;
            }
    }
}

// Reads `count` floats, or `count` rows of `width` floats; returns a sum that no compiler can leave out.
float read_all(const float *p, long count) {
    float total = 0;
#pragma omp parallel for schedule(dynamic, 64) reduction(+ : total)
    for (long first = 0; first < count; first += 4096) {
        long end = first + 4096 < count ? first + 4096 : count, k = first;
        v8 sum = {}, other = {};
        for (; k + 16 <= end; k += 16) sum += (v8)_mm256_loadu_ps(p + k), other += (v8)_mm256_loadu_ps(p + k + 8);
        sum += other;
        total += sum[0] + sum[7];
    }
    return total;
}
float read_rows(const float *p, const uint32_t *rows, long count, int width) {
    float total = 0;
#pragma omp parallel for schedule(dynamic, 8192) reduction(+ : total)
    for (long i = 0; i < count; i++) {
        const float *row = p + rows[i] * (long)width;
        v8 sum = {};
        for (int k = 0; k + 8 <= width; k += 8) sum += (v8)_mm256_loadu_ps(row + k);
        total += sum[0] + sum[7] + row[width - 1];
    }
    return total;
}
void write_all(float *p, long count) {
#pragma omp parallel for schedule(dynamic, 64)
    for (long first = 0; first < count; first += 4096)
        for (long k = first; k < (first + 4096 < count ? first + 4096 : count); k++) p[k] = k;
}
