// The standard tier's picture in plain C with OpenMP, as one would write it without OpenCL: projection in
// batches that the compiler vectorises, then triangle by triangle. Two styles: pixels as 64-bit keys that
// threads compete for with atomics, or triangles listed by bands of rows that belong to one thread each.
// Faces that reach in front of the near plane are dropped, not clipped, and shared edges are not exact: less
// work than ours.
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <omp.h>
typedef struct {
    float r[9], t[3], fx, fy, cx, cy;
    int w, h;
} Cam;
enum { BATCH = 64, BAND = 16 };
#define NEAR 0.01f
typedef struct {
    float x[3], y[3], q[3];
} Tri; // screen, 1/z

static int project(const float *restrict pos, const uint32_t *restrict idx, const float *restrict vt, long f0,
                   int n, const Cam *c, Tri *out, uint32_t *ids)
{
    float X[3 * BATCH], Y[3 * BATCH], Z[3 * BATCH];
    if (vt) { // shared vertices, already projected
        for (int i = 0; i < 3 * n; i++) {
            const float *v = vt + 4 * (size_t)idx[3 * f0 + i];
            X[i] = v[0];
            Y[i] = v[1];
            Z[i] = v[2];
        }
    } else {
        const float *p = pos + 9 * f0;
        for (int i = 0; i < 3 * n; i++) {
            float a = p[3 * i], b = p[3 * i + 1], d = p[3 * i + 2];
            float x = c->r[0] * a + c->r[1] * b + c->r[2] * d + c->t[0],
                  y = c->r[3] * a + c->r[4] * b + c->r[5] * d + c->t[1],
                  z = c->r[6] * a + c->r[7] * b + c->r[8] * d + c->t[2];
            float q = 1.0f / z;
            X[i] = c->fx * x * q + c->cx;
            Y[i] = c->fy * y * q + c->cy;
            Z[i] = z > NEAR ? q : -1.0f;
        }
    }
    int m = 0;
    for (int i = 0; i < n; i++) {
        float x0 = X[3 * i], x1 = X[3 * i + 1], x2 = X[3 * i + 2], y0 = Y[3 * i], y1 = Y[3 * i + 1],
              y2 = Y[3 * i + 2];
        float xl = fminf(fminf(x0, x1), x2), xh = fmaxf(fmaxf(x0, x1), x2), yl = fminf(fminf(y0, y1), y2),
              yh = fmaxf(fmaxf(y0, y1), y2);
        int ok = ceilf(xl - 0.5f) <= floorf(xh - 0.5f) & ceilf(yl - 0.5f) <= floorf(yh - 0.5f) & xh > 0 &
                 yh > 0 & xl < c->w & yl < c->h & Z[3 * i] > 0 & Z[3 * i + 1] > 0 & Z[3 * i + 2] > 0;
        Tri t = {{x0, x1, x2}, {y0, y1, y2}, {Z[3 * i], Z[3 * i + 1], Z[3 * i + 2]}};
        out[m] = t;
        ids[m] = (uint32_t)(f0 + i);
        m += ok;
    }
    return m;
}
typedef struct {
    float a0, b0, c0, a1, b1, c1, a2, b2, c2, A, B, C;
    int x0, x1, y0, y1;
} Set;
static inline int setup(const Tri *t, const Cam *c, Set *s)
{
    float a = (t->x[1] - t->x[0]) * (t->y[2] - t->y[0]) - (t->y[1] - t->y[0]) * (t->x[2] - t->x[0]);
    if (a == 0)
        return 0;
    float r = 1.0f / a;
    float xl = fminf(fminf(t->x[0], t->x[1]), t->x[2]), xh = fmaxf(fmaxf(t->x[0], t->x[1]), t->x[2]),
          yl = fminf(fminf(t->y[0], t->y[1]), t->y[2]), yh = fmaxf(fmaxf(t->y[0], t->y[1]), t->y[2]);
    s->x0 = (int)fmaxf(ceilf(xl - 0.5f), 0);
    s->x1 = (int)fminf(floorf(xh - 0.5f), c->w - 1);
    s->y0 = (int)fmaxf(ceilf(yl - 0.5f), 0);
    s->y1 = (int)fminf(floorf(yh - 0.5f), c->h - 1);
    float ox = s->x0 + 0.5f, oy = s->y0 + 0.5f;
    // barycentrics as planes from the first centre of the box
    s->a0 = -(t->y[2] - t->y[1]) * r;
    s->b0 = (t->x[2] - t->x[1]) * r;
    s->c0 = s->a0 * (ox - t->x[1]) + s->b0 * (oy - t->y[1]);
    s->a1 = -(t->y[0] - t->y[2]) * r;
    s->b1 = (t->x[0] - t->x[2]) * r;
    s->c1 = s->a1 * (ox - t->x[2]) + s->b1 * (oy - t->y[2]);
    s->a2 = -(t->y[1] - t->y[0]) * r;
    s->b2 = (t->x[1] - t->x[0]) * r;
    s->c2 = s->a2 * (ox - t->x[0]) + s->b2 * (oy - t->y[0]);
    s->A = s->a0 * t->q[0] + s->a1 * t->q[1] + s->a2 * t->q[2];
    s->B = s->b0 * t->q[0] + s->b1 * t->q[1] + s->b2 * t->q[2];
    s->C = s->c0 * t->q[0] + s->c1 * t->q[1] + s->c2 * t->q[2];
    return s->x0 <= s->x1 && s->y0 <= s->y1;
}
static void direct(const Tri *t, uint32_t id, const Cam *c, uint64_t *keys)
{
    Set s;
    if (!setup(t, c, &s))
        return;
    for (int y = s.y0; y <= s.y1; y++)
        for (int x = s.x0; x <= s.x1; x++) {
            float dx = x - s.x0, dy = y - s.y0;
            if (s.c0 + s.a0 * dx + s.b0 * dy >= 0 && s.c1 + s.a1 * dx + s.b1 * dy >= 0 &&
                s.c2 + s.a2 * dx + s.b2 * dy >= 0) {
                float q = s.C + s.A * dx + s.B * dy;
                uint32_t b;
                memcpy(&b, &q, 4);
                uint64_t k = (uint64_t)b << 32 | (uint32_t)~id, *p = keys + (size_t)y * c->w + x,
                         o = __atomic_load_n(p, __ATOMIC_RELAXED);
                while (k > o &&
                       !__atomic_compare_exchange_n(p, &o, k, 1, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {
                }
            }
        }
}
static void banded(const Tri *t, uint32_t id, const Cam *c, int lo, int hi, float *zb, uint32_t *ib)
{
    Set s;
    if (!setup(t, c, &s))
        return;
    int y0 = s.y0 > lo ? s.y0 : lo, y1 = s.y1 < hi - 1 ? s.y1 : hi - 1, n = s.x1 - s.x0 + 1;
    for (int y = y0; y <= y1; y++) {
        float dy = y - s.y0, c0 = s.c0 + s.b0 * dy, c1 = s.c1 + s.b1 * dy, c2 = s.c2 + s.b2 * dy,
              C = s.C + s.B * dy;
        float *restrict z = zb + (size_t)y * c->w + s.x0;
        uint32_t *restrict d = ib + (size_t)y * c->w + s.x0;
        if (n < 8) {
            for (int i = 0; i < n; i++) {
                float f = i, q = C + s.A * f;
                if (c0 + s.a0 * f >= 0 && c1 + s.a1 * f >= 0 && c2 + s.a2 * f >= 0 && q > z[i]) {
                    z[i] = q;
                    d[i] = id;
                }
            }
        } else {
#pragma omp simd
            for (int i = 0; i < n; i++) {
                float f = i, q = C + s.A * f;
                int in = (c0 + s.a0 * f >= 0) & (c1 + s.a1 * f >= 0) & (c2 + s.a2 * f >= 0) & (q > z[i]);
                z[i] = in ? q : z[i];
                d[i] = in ? id : d[i];
            }
        }
    }
}
static void shade(const float *pos, const uint32_t *idx, const uint8_t *col, const Cam *c,
                  const uint64_t *keys, const uint32_t *ib, const float *zb, int y, float *image)
{
    for (int x = 0; x < c->w; x++) {
        size_t p = (size_t)y * c->w + x;
        float *o = image + 3 * p;
        uint32_t id;
        if (keys) {
            if (!keys[p]) {
                o[0] = o[1] = o[2] = 0;
                continue;
            }
            id = ~(uint32_t)keys[p];
        } else {
            if (zb[p] == 0) {
                o[0] = o[1] = o[2] = 0;
                continue;
            }
            id = ib[p];
        }
        uint32_t v[3];
        for (int k = 0; k < 3; k++)
            v[k] = idx ? idx[3 * (size_t)id + k] : 3 * id + k;
        float X[3], Y[3], Z[3];
        for (int k = 0; k < 3; k++) {
            const float *a = pos + 3 * (size_t)v[k];
            X[k] = c->r[0] * a[0] + c->r[1] * a[1] + c->r[2] * a[2] + c->t[0];
            Y[k] = c->r[3] * a[0] + c->r[4] * a[1] + c->r[5] * a[2] + c->t[1];
            Z[k] = c->r[6] * a[0] + c->r[7] * a[1] + c->r[8] * a[2] + c->t[2];
        }
        float rx = (x + 0.5f - c->cx) / c->fx, ry = (y + 0.5f - c->cy) / c->fy;
        float x0 = X[0] - rx * Z[0], y0 = Y[0] - ry * Z[0], x1 = X[1] - rx * Z[1], y1 = Y[1] - ry * Z[1],
              x2 = X[2] - rx * Z[2], y2 = Y[2] - ry * Z[2];
        float w0 = x1 * y2 - x2 * y1, w1 = x2 * y0 - x0 * y2, w2 = x0 * y1 - x1 * y0,
              s = 1.0f / ((w0 + w1 + w2) * 255.0f);
        w0 *= s;
        w1 *= s;
        w2 *= s;
        const uint8_t *a = col + 4 * (size_t)v[0], *b = col + 4 * (size_t)v[1], *d = col + 4 * (size_t)v[2];
        for (int k = 0; k < 3; k++) {
            float q = w0 * a[k] + w1 * b[k] + w2 * d[k];
            o[k] = q < 0 ? 0 : q > 1 ? 1 : q;
        }
    }
}
// Draw a frame. `idx` is NULL for a soup. `vt` has 4 floats for each shared vertex, `keys` 8 bytes for each
// pixel.
void render(const float *pos, const uint32_t *idx, const uint8_t *col, long V, long F, const float *cam,
            int w, int h, int style, float *vt, uint64_t *keys, float *image, int threads)
{
    Cam c;
    memcpy(c.r, cam, 36);
    memcpy(c.t, cam + 9, 12);
    c.fx = cam[12];
    c.fy = cam[13];
    c.cx = cam[14];
    c.cy = cam[15];
    c.w = w;
    c.h = h;
    static uint32_t **list;
    static int *count, *room;
    static int lists; // per thread and band, kept between frames
    int bands = (h + BAND - 1) / BAND, nt = threads;
    omp_set_num_threads(nt);
    if (style == 1 && lists < nt * bands) {
        list = realloc(list, sizeof *list * nt * bands);
        count = realloc(count, sizeof(int) * nt * bands);
        room = realloc(room, sizeof(int) * nt * bands);
        for (int i = lists; i < nt * bands; i++) {
            list[i] = 0;
            room[i] = 0;
        }
        lists = nt * bands;
    }
    float *zb = (float *)keys;
    uint32_t *ib = (uint32_t *)(zb + (size_t)w * h);
#pragma omp parallel
    {
        int me = omp_get_thread_num();
#pragma omp for schedule(static)
        for (int y = 0; y < h; y++)
            if (style == 0)
                memset(keys + (size_t)y * w, 0, 8 * (size_t)w);
            else
                memset(zb + (size_t)y * w, 0, 4 * (size_t)w);
        if (idx) {
#pragma omp for schedule(static)
            for (long v = 0; v < V; v++) {
                const float *p = pos + 3 * v;
                float a = p[0], b = p[1], d = p[2];
                float x = c.r[0] * a + c.r[1] * b + c.r[2] * d + c.t[0],
                      y = c.r[3] * a + c.r[4] * b + c.r[5] * d + c.t[1],
                      z = c.r[6] * a + c.r[7] * b + c.r[8] * d + c.t[2], q = 1.0f / z;
                vt[4 * v] = c.fx * x * q + c.cx;
                vt[4 * v + 1] = c.fy * y * q + c.cy;
                vt[4 * v + 2] = z > NEAR ? q : -1.0f;
            }
        }
        Tri tri[BATCH];
        uint32_t ids[BATCH];
        if (style == 1)
            for (int b = 0; b < bands; b++)
                count[me * bands + b] = 0;
#pragma omp for schedule(dynamic, 64)
        for (long f = 0; f < (F + BATCH - 1) / BATCH; f++) {
            long f0 = f * BATCH;
            int n = F - f0 < BATCH ? F - f0 : BATCH;
            n = project(pos, idx, idx ? vt : 0, f0, n, &c, tri, ids);
            for (int i = 0; i < n; i++) {
                if (style == 0) {
                    direct(tri + i, ids[i], &c, keys);
                    continue;
                }
                float yl = fminf(fminf(tri[i].y[0], tri[i].y[1]), tri[i].y[2]),
                      yh = fmaxf(fmaxf(tri[i].y[0], tri[i].y[1]), tri[i].y[2]);
                int b0 = (int)fmaxf(ceilf(yl - 0.5f), 0) / BAND,
                    b1 = (int)fminf(floorf(yh - 0.5f), h - 1) / BAND;
                for (int b = b0; b <= b1; b++) {
                    int k = me * bands + b;
                    if (count[k] == room[k]) {
                        room[k] = room[k] ? 2 * room[k] : 1024;
                        list[k] = realloc(list[k], room[k] * (sizeof(Tri) + 4));
                    }
                    char *e = (char *)list[k] + (size_t)count[k]++ * (sizeof(Tri) + 4);
                    memcpy(e, tri + i, sizeof(Tri));
                    memcpy(e + sizeof(Tri), ids + i, 4);
                }
            }
        }
        if (style == 1) {
#pragma omp for schedule(dynamic, 1)
            for (int b = 0; b < bands; b++) {
                int hi = (b + 1) * BAND < h ? (b + 1) * BAND : h;
                for (int t = 0; t < nt; t++) {
                    int k = t * bands + b;
                    for (int i = 0; i < count[k]; i++) {
                        char *e = (char *)list[k] + (size_t)i * (sizeof(Tri) + 4);
                        uint32_t id;
                        memcpy(&id, e + sizeof(Tri), 4);
                        banded((Tri *)e, id, &c, b * BAND, hi, zb, ib);
                    }
                }
                for (int y = b * BAND; y < hi; y++)
                    shade(pos, idx, col, &c, 0, ib, zb, y, image);
            }
        } else {
#pragma omp for schedule(dynamic, 8)
            for (int y = 0; y < h; y++)
                shade(pos, idx, col, &c, keys, 0, 0, y, image);
        }
    }
}
