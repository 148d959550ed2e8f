// Front-to-back blending in CPU style.
// A work-item per tile blends eight samples of a row at a time, with private state and without barriers.
// PoCL does not vectorise work-items with data-dependent control flow.
// Explicit vectors are 4 to 6 times as fast as PoCL's scalar code.
// Four choices speed up inner loops.
// Loops without calls of built-in functions are 1.4 times as fast.
// Two rows at a time are 1.3 times as fast as one row. Prefetching faces is 1.2 times as fast, and one test
// instruction is 1.2 times as fast as any().

#define HALVES 2 // a row of a tile is two vectors wide
#define PAIRS 8  // rows are processed in pairs, so that two independent chains of operations overlap
#define ALL_PAIRS 0xffu

typedef struct {
    real t;
#if !SHARES
    real red, green, blue, z;
#if EXTRAS
    real nx, ny, nz, median;
    mask id;
#endif
#endif
} State;

// Returns whether a sample can still change.
// After the sample stops, its transmittance rejects all further faces.
// A stopped sample has a negative transmittance if the face that crosses the threshold is rejected.
// If that face is blended, the transmittance is at most the threshold.
#if BLENDS_CROSSING
#define RUNNING(t) ((t) > MIN_TRANSMITTANCE)
#else
#define RUNNING(t) ((t) > 0.0f)
#endif

#if SHARES
float sum_of(real v)
{
    float4 four = v.lo + v.hi;
    float2 two = four.lo + four.hi;
    return two.x + two.y;
}
#endif

// With SHARES, `spread` points to eight samples in the first of four planes, and `sum` has one sum per plane.
void blend_row(State *p, FACE_POINTER f, const Columns *c, float y, mask hit, const Sample *s
#if SHARES
               , __global const float *spread, size_t plane, real *sum
#endif
)
{
    real before = p->t, after = before * (1.0f - s->alpha);
#if BLENDS_CROSSING
    mask blended = hit & (before > MIN_TRANSMITTANCE);
    p->t = blended ? after : before;
#else
    mask blended = hit & (after >= MIN_TRANSMITTANCE);
    p->t = blended ? after : (hit ? -magnitude(before) : before);
#endif
    real weight = blended ? s->alpha * before : (real)0.0f;
#if SHARES
    for (int i = 0; i < 4; i++)
        sum[i] = MAD(weight, LOAD(spread + i * plane, 0), sum[i]);
#else
    real rgb[3], depth;
    shade(f, c, y, s, rgb, &depth);
    p->red = MAD(rgb[0], weight, p->red);
    p->green = MAD(rgb[1], weight, p->green);
    p->blue = MAD(rgb[2], weight, p->blue);
    // Outside a face, the extrapolated depth may be infinite, and infinity times 0 is NaN.
    p->z = blended ? MAD(depth, weight, p->z) : p->z;
#if EXTRAS
    float3 n = normal_of(f);
    p->nx = MAD(weight, (real)n.x, p->nx);
    p->ny = MAD(weight, (real)n.y, p->ny);
    p->nz = MAD(weight, (real)n.z, p->nz);
    mask half_seen = blended & (before > 0.5f);
    p->median = half_seen ? depth : p->median;
    p->id = half_seen ? (mask)f->number : p->id;
#endif
#endif
}

__kernel void BLEND(__constant View *view, __global const ulong *starts, __global const uint *list,
                    __global const Face *faces, __global float *planes, uint first_tile_row,
                    uint tile_rows SUMS)
{
    uint column = get_global_id(0) % view->columns, band_row = get_global_id(0) / view->columns;
    if (band_row >= tile_rows)
        return;
    uint tile = (first_tile_row + band_row) * view->columns + column;
    int left = column * TILE, top = (first_tile_row + band_row) * TILE;

#if SHARES
    // Without SHARES, the function `blend` computes the two values after its loop. In the loop, the values
    // would occupy registers, and the loop would take a few percent longer.
    uint stride = view->columns * TILE;
    size_t plane = (size_t)stride * tile_rows * TILE;
#endif
    State state[HALVES][TILE];
    uint alive[HALVES]; // bit p is set if rows 2p and 2p + 1 of this half have an open sample
    for (int h = 0; h < HALVES; h++) {
        real x = (float)(left + 8 * h) + LANE_INDEX;
        real start = x < (float)view->width ? (real)1.0f : (real)-1.0f;
        alive[h] = left + 8 * h < (int)view->width ? ALL_PAIRS : 0;
        if (top + TILE > (int)view->height)
            alive[h] &= (1u << (view->height - top + 1) / 2) - 1u;
        for (int r = 0; r < TILE; r++) {
            State *p = &state[h][r];
            p->t = top + r < (int)view->height ? start : (real)-1.0f;
#if !SHARES
            p->red = p->green = p->blue = p->z = (real)0.0f;
#if EXTRAS
            p->nx = p->ny = p->nz = p->median = (real)0.0f;
            p->id = (mask)-1;
#endif
#endif
        }
    }

    ulong end = starts[tile + 1];
    for (ulong e = starts[tile]; e < end; e++) {
        FACE_POINTER f = faces + list[e];
        FACE_POINTER next = faces + list[e + 4 < end ? e + 4 : e];
        PREFETCH_FAR(next); // the faces of a tile list are scattered in memory
        PREFETCH_FAR((__global const char *)next + 64);
        int y0 = (f->y0 > top ? f->y0 - top : 0) / 2;
        int y1 = (f->y1 - top < TILE - 1 ? f->y1 - top : TILE - 1) / 2;
        if (f->y1 < top || y0 > y1)
            continue;
        uint pairs = (ALL_PAIRS >> (PAIRS - 1 - y1)) & (ALL_PAIRS << y0);
#if SHARES
        real sum[4] = {(real)0.0f, (real)0.0f, (real)0.0f, (real)0.0f};
#endif
        for (int h = 0; h < HALVES; h++) {
            int from = left + 8 * h;
            if (!(alive[h] & pairs) || f->x1 < from || f->x0 > from + 7)
                continue;
            mask reached = reaches(f, (float)from, (float)top + 2.0f * LANE_INDEX);
            uint todo = alive[h] & pairs & (uint)bits8(reached);
            if (!todo)
                continue;
            Columns c = columns_of(f, (float)from + LANE_INDEX, view);
            for (; todo; todo &= todo - 1) {
                int k = LOWEST_BIT(todo);
                float y = (float)(top + 2 * k);
                Sample s, u;
                mask m = inside(f, &c, y, view, &s), n = inside(f, &c, y + 1.0f, view, &u);
                if (!ANY(m | n))
                    continue;
                m = cover(f, view, m, &s);
                n = cover(f, view, n, &u);
                if (!ANY(m | n))
                    continue;
                State *p = &state[h][2 * k];
#if SHARES
                __global const float *spread = planes + (size_t)(band_row * TILE + 2 * k) * stride + from;
                blend_row(p, f, &c, y, m, &s, spread, plane, sum);
                blend_row(p + 1, f, &c, y + 1.0f, n, &u, spread + stride, plane, sum);
#else
                blend_row(p, f, &c, y, m, &s);
                blend_row(p + 1, f, &c, y + 1.0f, n, &u);
#endif
#if EARLY_STOP
                if (!ANY(RUNNING(p[0].t) | RUNNING(p[1].t)))
                    alive[h] &= ~(1u << k);
#endif
            }
        }
#if SHARES
        for (int i = 0; i < 4; i++)
            sums[4 * e + i] = sum_of(sum[i]);
#endif
#if EARLY_STOP
        if (!(alive[0] | alive[1]))
            break;
#endif
    }

#if !SHARES
    uint stride = view->columns * TILE;
    size_t plane = (size_t)stride * tile_rows * TILE;
    for (int r = 0; r < TILE; r++)
        for (int h = 0; h < HALVES; h++) {
            __global float *out = planes + (size_t)(band_row * TILE + r) * stride + left + 8 * h;
            vstore8(state[h][r].red, 0, out);
            vstore8(state[h][r].green, 0, out + plane);
            vstore8(state[h][r].blue, 0, out + 2 * plane);
            vstore8(magnitude(state[h][r].t), 0, out + 3 * plane);
            vstore8(state[h][r].z, 0, out + 4 * plane);
#if EXTRAS
            vstore8(state[h][r].nx, 0, out + 5 * plane);
            vstore8(state[h][r].ny, 0, out + 6 * plane);
            vstore8(state[h][r].nz, 0, out + 7 * plane);
            vstore8(state[h][r].median, 0, out + 8 * plane);
            vstore8(state[h][r].id, 0, (__global int *)(out + 9 * plane));
#endif
        }
#endif
}
