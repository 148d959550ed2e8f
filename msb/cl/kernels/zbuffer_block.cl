// The opaque z-buffer on a CPU within a tile.
// The code draws eight triangles at once into planes of depths and slots (triangle numbers).

#define TINY (7 * UNIT)     // maximum extent of a triangle for edge functions in int32
#define MEDIUM SMALL_EXTENT // maximum extent of a triangle for edge functions divided by UNIT in int32
#define COARSE_X 5         // log2 of the sides of the 32 x 16 pixel blocks that store their farthest depth
#define COARSE_Y 4
#define COARSE_ROW 8  // at most 8 x 8 blocks in a tile of 256 x 128
#define WORK_BITS 5   // log2 of the pixels of a large triangle that cost as much as a small triangle
#define MASKED (-1.0f) // a depth behind every surface

typedef struct {
    __global float *depth; // 1 / z: a larger value is nearer, 0 means no surface
    __global int *slot;    // slot (number) of the nearest triangle
    __global float *far;   // the farthest depth in each block of pixels
    int occludes;          // whether any farthest depth is not 0
    // approximate number of small triangles drawn since the last `measure`, and the number that triggers the
    // next `measure`
    int work, limit;
    int stride;
    int x0, y0, x1, y1;    // range of pixels of the image, ends excluded
    __global const float *triangles;
#if COLORS == TEXTURES
    Textures textures;
#endif
} Tile;

int face_of(const Tile *t, int slot) { return INTEGERS(t->triangles)[(size_t)slot * WORDS + FACE_WORD]; }

// Returns whether every surface at this depth or farther is hidden in a box of image pixels, ends included.
int hidden(const Tile *t, int x0, int y0, int x1, int y1, float depth)
{
    x0 = (x0 - t->x0) >> COARSE_X;
    x1 = (x1 - t->x0) >> COARSE_X;
    y0 = (y0 - t->y0) >> COARSE_Y;
    y1 = (y1 - t->y0) >> COARSE_Y;
    for (int y = y0; y <= y1; y++)
        for (int x = x0; x <= x1; x++)
            if (t->far[y * COARSE_ROW + x] <= depth) // at equal depths the lower face wins
                return 0;
    return 1;
}

// Compute the depth of the farthest pixel of each block.
void measure(Tile *t)
{
    int width = t->x1 - t->x0, height = t->y1 - t->y0, some = 0;
    for (int by = 0; by << COARSE_Y < height; by++)
        for (int bx = 0; bx << COARSE_X < width; bx++) {
            int x_end = MIN((bx + 1) << COARSE_X, width), y_end = MIN((by + 1) << COARSE_Y, height);
            float8 least = (float8)3e38f;
            float low = 3e38f;
            for (int y = by << COARSE_Y; y < y_end && low > 0.0f; y++) {
                __global const float *row = t->depth + y * t->stride;
                int x = bx << COARSE_X;
                for (; x + 8 <= x_end; x += 8)
                    least = min8(least, LOAD(row + x, 0));
                for (; x < x_end; x++)
                    low = MIN(low, row[x]);
                if ((y & 3) == 3 && any8(least == 0.0f))
                    low = 0.0f;
            }
            for (int l = 0; l < 8; l++)
                low = MIN(low, PICK_F(least, l));
            t->far[by * COARSE_ROW + bx] = low;
            some |= low > 0.0f;
        }
    t->occludes = some;
    t->work = 0;
    if (!some) // every block has an empty pixel, so measure less often
        t->limit *= 2;
}

// Keep the nearer surface at eight pixels of a row. Return a mask of the pixels with equal depths.
int8 keep(const Tile *t, int at, float8 depth, int slot)
{
    float8 old = LOAD(t->depth + at, 0);
    int8 old_slot = LOAD_INT(t->slot + at), nearer = depth > old;
    *(__global loose_float8 *)(t->depth + at) = nearer ? depth : old;
    *(__global loose_int8 *)(t->slot + at) = nearer ? (int8)slot : old_slot;
    return depth == old;
}

// Where depths are equal, the lowest face wins.
void settle(const Tile *t, int at, float depth, int slot)
{
    if (depth == t->depth[at] && face_of(t, slot) < face_of(t, t->slot[at]))
        t->slot[at] = slot;
}

// With an alpha cutoff, reject pixels with a texture alpha below the cutoff.
// Pixels behind the depth `old` need no test.
#if COLORS == TEXTURES && CUTOFF
float8 cut(const Tile *t, int8 slot, int8 x, int8 y, float8 depth, float8 old, __constant float *view)
{
    int8 nearer = (depth > 0.0f) & (depth >= old);
    if (!any8(nearer))
        return depth;
    float8 light[4], px = TO_FLOAT(x) + 0.5f - view[OPTICAL], py = TO_FLOAT(y) + 0.5f - view[OPTICAL + 1];
    surface(&t->textures, view, slot, px, py, light);
    return (nearer & (light[3] < CUTOFF_OF(&t->textures))) ? (float8)MASKED : depth;
}
#define CUT(depth, slot, x, y, old) depth = cut(t, (int8)(slot), (int8)(x), (int8)(y), depth, old, view);
#else
#define CUT(depth, slot, x, y, old)
#endif

// Draw a triangle of any size in spans of pixels, row by row. The triangle may need clipping.
void draw_outline(Tile *t, int slot, __constant float *view)
{
    const int8 lane = (int8)(0, 1, 2, 3, 4, 5, 6, 7);
    Outline o = make_outline(t->triangles + (size_t)slot * WORDS, view);
    for (int k = 1; k + 1 < o.n; k++) {
        Edges s = make_edges(&o, k, t->x0, t->y0, t->x1, t->y1);
        if (s.x0 > s.x1 || s.y0 > s.y1)
            continue;
        if (t->occludes && hidden(t, s.x0, s.y0, s.x1, s.y1, o.high))
            continue;
        // If the whole box is on the inner side of an edge, no division is needed. If the whole box is on the
        // outer side of an edge, the triangle covers no pixel.
        int cuts[3], outside = 0;
        for (int i = 0; i < 3; i++) {
            long down = s.dx[i] * (s.y1 - s.y0), right = -s.dy[i] * (s.x1 - s.x0);
            outside |= s.e[i] + MAX(down, 0) + MAX(right, 0) < 0;
            cuts[i] = s.e[i] + MIN(down, 0) + MIN(right, 0) < 0;
        }
        if (outside)
            continue;
        int at = (s.y0 - t->y0) * t->stride + s.x0 - t->x0;
        int u = (s.x0 << SUBPIXEL_BITS) + HALF - o.u_reference;
        t->work += (s.x1 - s.x0 + 1) * (s.y1 - s.y0 + 1) >> WORK_BITS;
        for (int y = s.y0; y <= s.y1; y++, at += t->stride) {
            long first = 0, last = s.x1 - s.x0;
            for (int i = 0; i < 3; i++) { // condition: e - x dy >= 0
                if (!cuts[i])
                    continue;
                if (s.dy[i] > 0)
                    last = MIN(last, s.e[i] < 0 ? -1 : s.e[i] / s.dy[i]);
                else if (s.e[i] < 0)
                    first = s.dy[i] == 0 ? last + 1 : MAX(first, (s.e[i] + s.dy[i] + 1) / s.dy[i]);
                s.e[i] += s.dx[i];
            }
            float v = (float)((y << SUBPIXEL_BITS) + HALF - o.v_reference);
            float row = MAD(o.b, v, o.reference);
            for (int x = (int)first; x <= (int)last; x += 8) {
                float8 depth = MAD(o.a, TO_FLOAT(((x + lane) << SUBPIXEL_BITS) + u), row);
                if (o.wide)
                    for (int l = 0; l < 8; l++)
                        ((float *)&depth)[l] = wide_depth(&o, s.x0 + x + l, y, view);
                depth = min8(max8(depth, (float8)o.low), (float8)o.high);
                depth = x + lane > (int)last ? (float8)MASKED : depth;
                CUT(depth, slot, s.x0 + x + lane, y, LOAD(t->depth + at + x, 0))
                if (any8(keep(t, at + x, depth, slot)))
                    for (int l = 0; l < 8; l++)
                        settle(t, at + x + l, PICK_F(depth, l), slot);
            }
        }
    }
}

// ---- eight triangles

// Edge functions of eight triangles in 64 bits, divided by UNIT.
// The values fit into 32 bits up to the extent MEDIUM.
#define WIDE(a, b) (TO_LONG4(a) * TO_LONG4(b))
int8 edge8(int8 dx, int8 dy, int8 to_x, int8 to_y)
{
    int8 owns = (dy < 0) | ((dy == 0) & (dx > 0));
    long4 low = WIDE(dx.lo, to_y.lo) - WIDE(dy.lo, to_x.lo) + TO_LONG4(~owns.lo);
    long4 high = WIDE(dx.hi, to_y.hi) - WIDE(dy.hi, to_x.hi) + TO_LONG4(~owns.hi);
    // Only the low half is kept, so the logical shift of AVX2 suffices.
    return (int8)(TO_INT4(as_ulong4(low) >> SUBPIXEL_BITS), TO_INT4(as_ulong4(high) >> SUBPIXEL_BITS));
}

// Edge functions in 32 bits, not divided by UNIT, for extents below TINY.
int8 edge8_tiny(int8 dx, int8 dy, int8 to_x, int8 to_y)
{
    int8 owns = ((dy << 16) - dx) >> 31; // top or left edge: dy < 0, or dy == 0 and dx > 0
    return dx * to_y - dy * to_x + ~owns;
}

void draw_block(Tile *t, int block, __constant float *view)
{
    __global const float *r = t->triangles + (size_t)block * (8 * WORDS);
    int slot = 8 * block;
    float8 c0 = LOAD(r, 0), c1 = LOAD(r, 2), c2 = LOAD(r, 4), c3 = LOAD(r, 6);
    float8 c4 = LOAD(r, 8), c5 = LOAD(r, 10), c6 = LOAD(r, 12), c7 = LOAD(r, 14);
    TRANSPOSE(c0, c1, c2, c3, c4, c5, c6, c7)
    float8 c8 = (float8)(r[8], r[24], r[40], r[56], r[72], r[88], r[104], r[120]);
    float8 X0, Y0, Z0, X1, Y1, Z1, X2, Y2, Z2;
    TO_CAMERA(view, c0, c1, c2, X0, Y0, Z0)
    TO_CAMERA(view, c3, c4, c5, X1, Y1, Z1)
    TO_CAMERA(view, c6, c7, c8, X2, Y2, Z2)
    float8 q0 = 1.0f / Z0, q1 = 1.0f / Z1, q2 = 1.0f / Z2;
    float pu = view[PRINCIPAL], pv = view[PRINCIPAL + 1];
    int8 U0 = TO_INT(MAD(X0, q0, pu)), V0 = TO_INT(MAD(Y0, q0, pv));
    int8 U1 = TO_INT(MAD(X1, q1, pu)), V1 = TO_INT(MAD(Y1, q1, pv));
    int8 U2 = TO_INT(MAD(X2, q2, pu)), V2 = TO_INT(MAD(Y2, q2, pv));
    int8 u_low = min8i(min8i(U0, U1), U2), u_high = max8i(max8i(U0, U1), U2);
    int8 v_low = min8i(min8i(V0, V1), V2), v_high = max8i(max8i(V0, V1), V2);

    // Select pixels with their centre in the box of the triangle.
    // Most small triangles contain no pixel centre of this tile.
    int8 x0 = max8i((u_low + (HALF - 1)) >> SUBPIXEL_BITS, (int8)t->x0);
    int8 y0 = max8i((v_low + (HALF - 1)) >> SUBPIXEL_BITS, (int8)t->y0);
    int8 w = min8i((u_high - HALF) >> SUBPIXEL_BITS, (int8)(t->x1 - 1)) - x0;
    int8 h = min8i((v_high - HALF) >> SUBPIXEL_BITS, (int8)(t->y1 - 1)) - y0;
    int8 ahead = max8(max8(Z0, Z1), Z2) >= NEAR;
    // A conversion that overflows gives the lowest or highest integer, which lies outside the guard band.
    int8 whole = (min8(min8(Z0, Z1), Z2) >= NEAR) & (min8i(u_low, v_low) > -GUARD) & (max8i(u_high, v_high) < GUARD);
    int8 odd = ahead & ~whole; // these triangles must be clipped
    int8 seen = (whole & ((w | h) >= 0)) | odd;
    if (!any8(seen))
        return;
    int8 extent = max8i(u_high - u_low, v_high - v_low);
    int8 tiny = seen & ~odd & (extent < TINY) & ((w | h) < 4);
    int8 medium = seen & ~odd & ~tiny & (extent < MEDIUM);
    int8 large = seen & ~tiny & ~medium;

    // Edge functions are oriented so that the inside is positive.
    // In 32 bits the sign of the area is correct only for tiny triangles.
    int8 dx0 = U1 - U0, dy0 = V1 - V0, dx2 = U0 - U2, dy2 = V0 - V2;
    int8 to_x = (x0 << SUBPIXEL_BITS) + HALF, to_y = (y0 << SUBPIXEL_BITS) + HALF;
    int8 covered = (int8)0; // bit 4 y + x stands for pixel (x, y) of the box
    if (any8(tiny)) {
        int8 area = dx2 * dy0 - dx0 * dy2, s = area >> 31;
        tiny &= area != 0;
        int8 ax0 = (dx0 ^ s) - s, ay0 = (dy0 ^ s) - s, ax2 = (dx2 ^ s) - s, ay2 = (dy2 ^ s) - s;
        int8 ax1 = -(ax0 + ax2), ay1 = -(ay0 + ay2);
        int8 e0 = edge8_tiny(ax0, ay0, to_x - U0, to_y - V0);
        int8 e1 = edge8_tiny(ax1, ay1, to_x - U1, to_y - V1);
        int8 e2 = edge8_tiny(ax2, ay2, to_x - U2, to_y - V2);
        ax0 <<= SUBPIXEL_BITS;
        ay0 <<= SUBPIXEL_BITS;
        ax1 <<= SUBPIXEL_BITS;
        ay1 <<= SUBPIXEL_BITS;
        ax2 <<= SUBPIXEL_BITS;
        ay2 <<= SUBPIXEL_BITS;
        // Pixels outside the box fail an edge test, or fall into the padding of the tile.
        int sizes = or8((w | h << 4) & tiny);
        int8 f0 = e0, f1 = e1, f2 = e2, outside;
#define OUTSIDE(bit) (((f0 | f1 | f2) >> 31) & (bit))
#define RIGHT                                                                                                   \
    f0 -= ay0;                                                                                                  \
    f1 -= ay1;                                                                                                  \
    f2 -= ay2;
#define DOWN                                                                                                    \
    f0 = e0 += ax0;                                                                                             \
    f1 = e1 += ax1;                                                                                             \
    f2 = e2 += ax2;
        if (!(sizes & 0x22)) { // the box has at most 2 x 2 pixels
            outside = OUTSIDE(1);
            RIGHT outside |= OUTSIDE(2);
            DOWN outside |= OUTSIDE(16);
            RIGHT outside |= OUTSIDE(32);
            covered = tiny & 0x33 & ~outside;
        } else {
            int rows = sizes & 0x20 ? 4 : (sizes >> 4 & 3) + 1, shift = 0;
            covered = tiny & ((1 << 4 * rows) - 1);
            for (;;) {
                outside = OUTSIDE(1);
                RIGHT outside |= OUTSIDE(2);
                RIGHT outside |= OUTSIDE(4);
                RIGHT outside |= OUTSIDE(8);
                covered &= ~(outside << shift);
                shift += 4;
                if (shift == 4 * rows)
                    break;
                DOWN
            }
        }
    }
    if (!any8(covered | medium | large))
        return;

    DEPTH_PLANE(float8, X0, Y0, Z0, X1, Y1, Z1, X2, Y2, Z2, A, B, unused)
    float8 low = min8(min8(q0, q1), q2), high = max8(max8(q0, q1), q2);
    int8 deep = DEEP(low, high) & ((covered != 0) | medium);
    if (any8(deep)) {
        covered &= ~deep;
        medium &= ~deep;
        large |= deep;
    }
    int8 ru = HALF - U0, rv = HALF - V0;
    int8 base = (y0 - t->y0) * t->stride + (x0 - t->x0);
    while (any8(covered)) { // handle the first covered pixel of each triangle, then the second
        int8 bit = covered & -covered, mask = covered != 0;
        covered ^= bit;
        int8 index = (as_int8(TO_FLOAT(bit)) >> 23) - 127, x = index & 3, y = (index >> 2) & 3;
        float8 row = MAD(B, TO_FLOAT(((y0 + y) << SUBPIXEL_BITS) + rv), q0);
        float8 depth = MAD(A, TO_FLOAT(((x0 + x) << SUBPIXEL_BITS) + ru), row);
        depth = min8(max8(depth, low), high);
        depth = mask ? depth : (float8)MASKED;
        int8 at = (base + y * t->stride + x) & mask;
        CUT(depth, slot + (int8)(0, 1, 2, 3, 4, 5, 6, 7), x0 + x, y0 + y, GATHER(float8, t->depth, at))
        // This code has no branches, because it is unpredictable which triangle is nearer.
        // Depths are non-negative, so comparing their bits as integers gives the same order.
#define KEEP(l)                                                                                                 \
    {                                                                                                           \
        int p = at.s##l, z = as_int(depth.s##l), old = ((__global int *)t->depth)[p], old_slot = t->slot[p];    \
        if (z == old && face_of(t, slot + l) < face_of(t, old_slot))                                            \
            old_slot = slot + l;                                                                                \
        t->slot[p] = z > old ? slot + l : old_slot;                                                             \
        ((__global int *)t->depth)[p] = z > old ? z : old;                                                      \
    }
        KEEP(0) KEEP(1) KEEP(2) KEEP(3) KEEP(4) KEEP(5) KEEP(6) KEEP(7)
    }

    int lanes = bits8(medium);
    if (lanes) { // draw rows of eight pixels, triangle by triangle
        int8 dx1 = -(dx0 + dx2), dy1 = -(dy0 + dy2);
        long4 area_low = WIDE(dx2.lo, dy0.lo) - WIDE(dx0.lo, dy2.lo);
        long4 area_high = WIDE(dx2.hi, dy0.hi) - WIDE(dx0.hi, dy2.hi);
        int8 top = (int8)(TO_INT4(area_low >> 32), TO_INT4(area_high >> 32)), s = top >> 31;
        lanes &= bits8((top | (int8)(TO_INT4(area_low), TO_INT4(area_high))) != 0);
        dx0 = (dx0 ^ s) - s;
        dy0 = (dy0 ^ s) - s;
        dx1 = (dx1 ^ s) - s;
        dy1 = (dy1 ^ s) - s;
        dx2 = (dx2 ^ s) - s;
        dy2 = (dy2 ^ s) - s;
        int8 e0 = edge8(dx0, dy0, to_x - U0, to_y - V0);
        int8 e1 = edge8(dx1, dy1, to_x - U1, to_y - V1);
        int8 e2 = edge8(dx2, dy2, to_x - U2, to_y - V2);
        const int8 lane = (int8)(0, 1, 2, 3, 4, 5, 6, 7);
        for (; lanes; lanes &= lanes - 1) {
            int l = LOWEST_BIT(lanes), right = PICK(w, l), rows = PICK(h, l);
            int left = PICK(x0, l), up = PICK(y0, l), first = PICK(base, l);
            float nearest = PICK_F(high, l), farthest = PICK_F(low, l);
            if (t->occludes && hidden(t, left, up, left + right, up + rows, nearest))
                continue;
            int down0 = PICK(dx0, l), down1 = PICK(dx1, l), down2 = PICK(dx2, l);
            int across0 = PICK(dy0, l), across1 = PICK(dy1, l), across2 = PICK(dy2, l);
            float a = PICK_F(A, l), b = PICK_F(B, l), reference = PICK_F(q0, l);
            int v = (up << SUBPIXEL_BITS) + PICK(rv, l);
            for (int x = 0; x <= right; x += 8) {
                int8 f0 = PICK(e0, l) - (x + lane) * across0;
                int8 f1 = PICK(e1, l) - (x + lane) * across1;
                int8 f2 = PICK(e2, l) - (x + lane) * across2;
                float8 u = TO_FLOAT(((left + x + lane) << SUBPIXEL_BITS) + PICK(ru, l));
                int8 ties = (int8)0;
                int at = first + x;
                for (int y = 0; y <= rows; y++, at += t->stride) {
                    float8 depth = MAD(a, u, MAD(b, (float)(v + (y << SUBPIXEL_BITS)), reference));
                    depth = min8(max8(depth, (float8)farthest), (float8)nearest);
                    depth = (f0 | f1 | f2) < 0 ? (float8)MASKED : depth;
                    CUT(depth, slot + l, left + x + lane, up + y, LOAD(t->depth + at, 0))
                    ties |= keep(t, at, depth, slot + l);
                    f0 += down0;
                    f1 += down1;
                    f2 += down2;
                }
                if (any8(ties)) // rare case: process the column again
                    for (int y = 0; y <= rows; y++) {
                        at -= t->stride;
                        f0 -= down0;
                        f1 -= down1;
                        f2 -= down2;
                        float row = MAD(b, (float)(v + ((rows - y) << SUBPIXEL_BITS)), reference);
                        float8 depth = MAD(a, u, row);
                        depth = min8(max8(depth, (float8)farthest), (float8)nearest);
                        depth = (f0 | f1 | f2) < 0 ? (float8)MASKED : depth;
                        CUT(depth, slot + l, left + x + lane, up + rows - y, LOAD(t->depth + at, 0))
                        for (int i = 0; i < 8; i++)
                            settle(t, at + i, PICK_F(depth, i), slot + l);
                    }
            }
        }
    }
    for (lanes = bits8(large); lanes; lanes &= lanes - 1) {
        int l = LOWEST_BIT(lanes), left = PICK(x0, l), up = PICK(y0, l);
        if (t->occludes && !PICK(odd, l) && hidden(t, left, up, left + PICK(w, l), up + PICK(h, l), PICK_F(high, l)))
            continue;
        draw_outline(t, slot + l, view);
    }
}
