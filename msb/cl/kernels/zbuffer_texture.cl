// Textures for the opaque z-buffer: what they show of a face at a sample, eight samples at once (LANES 8) or one.
// The rules are in docs/standard.md, the readable twin is `sample` in msb/asset/texture.py.
//
// A record has u, v of the corners in UV_WORD and behind FACE_WORD. `tints` has, if there are any, linear light and
// alpha of each slot's corners, `numbers` the texture of each slot if there are several, `texels` all levels of all
// textures, linear light and alpha in 16 bits each. `rows` says how to read them:
//   row 0            whether texels are not blended, whether smaller levels are read, wrap of u, wrap of v
//   row 1            alpha below which there is nothing, as a float; whether there are tints; several textures
//   row 2 + 16t + l  level l of texture t: its first texel, and for l = 0 width, height, and the last level

#define CLAMPED 1 // wraps; 0 repeats
#define MIRRORED 2
#define FIRST_ROW 2
#define LEVEL_ROWS 16
#define TINT_WORDS 12

typedef struct {
    __global const float *triangles, *tints;
    __global const uint *numbers;
    __global const ushort4 *texels;
    __global const int *rows;
} Textures;
#define CUTOFF_OF(t) as_float((t)->rows[4])
#define IS_TINTED(t) ((t)->rows[5])
#define ARE_SEVERAL(t) ((t)->rows[6])
// The arguments of a kernel that draws, and what they are to it.
#define TEXTURE_ARGUMENTS                                                                                       \
    , __global const uint *numbers, __global const ushort4 *texels, __global const int *level_rows
#define TEXTURES_OF(triangles, tints) {triangles, tints, numbers, texels, level_rows}

#if LANES == 8
typedef float8 floats;
typedef int8 ints;
#define FLOATS_OF(i) TO_FLOAT(i)
#define INTS_OF(x) TO_INT(x)
#define AS_FLOATS(i) as_float8(i)
#define AS_INTS(x) as_int8(x)
#define ANY(mask) any8(mask)
#define GATHER(type, p, i)                                                                                      \
    (type)((p)[(i).s0], (p)[(i).s1], (p)[(i).s2], (p)[(i).s3], (p)[(i).s4], (p)[(i).s5], (p)[(i).s6], (p)[(i).s7])
#define ROW_OF(p, words, slot, lane, i) LOAD((p) + (size_t)(slot).s##lane * (words) + (i), 0)
// Eight words of each of eight records, from word i on.
#define EIGHT_WORDS(p, words, slot, i, w)                                                                       \
    {                                                                                                           \
        w[0] = ROW_OF(p, words, slot, 0, i), w[1] = ROW_OF(p, words, slot, 1, i);                               \
        w[2] = ROW_OF(p, words, slot, 2, i), w[3] = ROW_OF(p, words, slot, 3, i);                               \
        w[4] = ROW_OF(p, words, slot, 4, i), w[5] = ROW_OF(p, words, slot, 5, i);                               \
        w[6] = ROW_OF(p, words, slot, 6, i), w[7] = ROW_OF(p, words, slot, 7, i);                               \
        TRANSPOSE(w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7])                                               \
    }
#define SHORTS_TO_FLOATS(b) TO_FLOAT(b)
#define ROOT(x) sqrt8(x)
#define LANE(v, l) PICK(v, l)
#define LANE_F(v, l) PICK_F(v, l)
#else
typedef float floats;
typedef int ints;
#define FLOATS_OF(i) ((float)(i))
#define INTS_OF(x) ((int)(x))
#define AS_FLOATS(i) as_float(i)
#define AS_INTS(x) as_int(x)
#define ANY(mask) (mask)
#define GATHER(type, p, i) (type)((p)[i])
#define EIGHT_WORDS(p, words, slot, i, w)                                                                       \
    for (int word = 0; word < 8; word++)                                                                        \
        w[word] = (p)[(size_t)(slot) * (words) + (i) + word];
#define SHORTS_TO_FLOATS(b) convert_float8(b)
#define ROOT(x) sqrt(x)
#define LANE(v, l) (v)
#define LANE_F(v, l) (v)
#endif

floats floor_of(floats x)
{
    floats whole = FLOATS_OF(INTS_OF(x));
    whole = whole > x ? whole - 1.0f : whole;
    return x < 8388608.0f ? (x > -8388608.0f ? whole : x) : x; // beyond, floats are whole
}

// With m the mantissa in sqrt(1/2) to sqrt(2) and s = (m - 1) / (m + 1): log m = 2 (s + s^3 / 3 + s^5 / 5 + ...).
// Right to 1e-7 for positive normal numbers.
floats log2_of(floats x)
{
    ints bits = AS_INTS(x), exponent = (bits - 0x3f3504f3) >> 23;
    floats m = AS_FLOATS(bits - (exponent << 23)), s = (m - 1.0f) / (m + 1.0f), square = s * s;
    floats series = MAD(square, MAD(square, MAD(square, (floats)0.41219858f, (floats)0.57707801f),
        (floats)0.96179669f), (floats)2.88539008f);
    return MAD(s, series, FLOATS_OF(exponent));
}

// Linear light to sRGB (IEC 61966-2-1); above its straight part a polynomial in the fourth root, right to 2e-6.
floats encoded(floats x)
{
    floats root = ROOT(ROOT(x));
    floats curve = MAD(root, (floats)0.06820814f, (floats)(-0.31841745f));
    curve = MAD(root, curve, (floats)0.65719179f);
    curve = MAD(root, curve, (floats)(-0.85296119f));
    curve = MAD(root, curve, (floats)1.36592304f);
    curve = MAD(root, curve, (floats)0.13960362f);
    curve = MAD(root, curve, (floats)(-0.05954656f));
    floats made = x > 0.0031308f ? curve : 12.92f * x;
    return made < 1.0f ? made : (floats)1.0f;
}

// A texture coordinate as one within the texture: 0 to 1, whatever it was.
floats folded(floats u, int wrap)
{
    if (wrap == MIRRORED) {
        u -= 2.0f * floor_of(0.5f * u);
        u = u > 1.0f ? 2.0f - u : u;
    } else if (wrap != CLAMPED)
        u -= floor_of(u);
    return u > 0.0f ? (u < 1.0f ? u : (floats)1.0f) : (floats)0.0f;
}

// Where a level is read: its four texels, the shares of the upper and the lower two, and that of the right ones in both.
typedef struct {
    ints upper_left, upper_right, lower_left, lower_right;
    floats upper, lower, right;
} Taps;

// The taps of level `level` of the textures whose first row is `row`, times a share; u, v are folded.
Taps taps_of(const Textures *t, ints row, ints level, ints width, ints height, floats u, floats v, floats share)
{
    Taps taps;
    ints at = 4 * (row + level), first = GATHER(ints, t->rows, at);
    width >>= level;
    height >>= level;
    width = width > 1 ? width : (ints)1;
    height = height > 1 ? height : (ints)1;
    // A texel that is read alone is the left and upper one of four.
    int alone = t->rows[0];
    floats shift = (floats)(alone ? 0.0f : -0.5f);
    floats x = MAD(u, FLOATS_OF(width), shift), y = MAD(v, FLOATS_OF(height), shift);
    floats left = floor_of(x), up = floor_of(y);
    ints x0 = INTS_OF(left), y0 = INTS_OF(up), x1 = x0 + 1, y1 = y0 + 1;
    // Past an edge lies the opposite one, or the edge itself.
    int around_x = t->rows[2] == 0, around_y = t->rows[3] == 0;
    x0 = x0 < 0 ? (around_x ? width - 1 : (ints)0) : (x0 < width ? x0 : width - 1);
    y0 = y0 < 0 ? (around_y ? height - 1 : (ints)0) : (y0 < height ? y0 : height - 1);
    x1 = x1 < width ? x1 : (around_x ? (ints)0 : width - 1);
    y1 = y1 < height ? y1 : (around_y ? (ints)0 : height - 1);
    taps.right = alone ? (floats)0.0f : x - left;
    share *= 1.0f / 65535.0f;
    taps.lower = alone ? (floats)0.0f : share * (y - up);
    taps.upper = share - taps.lower;
    y0 = first + y0 * width;
    y1 = first + y1 * width;
    taps.upper_left = y0 + x0;
    taps.upper_right = y0 + x1;
    taps.lower_left = y1 + x0;
    taps.lower_right = y1 + x1;
    return taps;
}

// What the taps of one sample show, the left texels' part and the right ones'.
#define TWO(left, right) SHORTS_TO_FLOATS((ushort8)(texels[LANE(left, l)], texels[LANE(right, l)]))
float8 blended(__global const ushort4 *texels, const Taps *taps, int l)
{
    float right = LANE_F(taps->right, l);
    float8 lower = TWO(taps->lower_left, taps->lower_right) * LANE_F(taps->lower, l);
    float8 both = MAD(TWO(taps->upper_left, taps->upper_right), (float8)LANE_F(taps->upper, l), lower);
    return both * (float8)((float4)(1.0f - right), (float4)right);
}

// Weights of the second and third corner at a sample, and their steps to the next pixel along x and along y: in all
// w[0], w[1], w[0] along x, w[1] along x, w[0] along y, w[1] along y. As WEIGHTS; the volumes are written as products
// of the ray with vectors that are the same for the whole face, so their steps are those of the ray's.
void weights_and_steps(const floats *c, __constant float *view, floats px, floats py, floats *w)
{
    floats ax = c[3] - c[0], ay = c[4] - c[1], az = c[5] - c[2];
    floats bx = c[6] - c[0], by = c[7] - c[1], bz = c[8] - c[2];
    floats tx = view[REST] - (c[0] - view[CENTER]), ty = view[REST + 1] - (c[1] - view[CENTER + 1]);
    floats tz = view[REST + 2] - (c[2] - view[CENTER + 2]);
    CROSS(floats, ux, uy, uz, bx, by, bz, tx, ty, tz)
    CROSS(floats, vx, vy, vz, tx, ty, tz, ax, ay, az)
    CROSS(floats, nx, ny, nz, bx, by, bz, ax, ay, az)
    floats dx = MAD(px, view[RAY], MAD(py, view[RAY + 3], view[RAY + 6]));
    floats dy = MAD(px, view[RAY + 1], MAD(py, view[RAY + 4], view[RAY + 7]));
    floats dz = MAD(px, view[RAY + 2], MAD(py, view[RAY + 5], view[RAY + 8]));
    DOT(floats, u, dx, dy, dz, ux, uy, uz)
    DOT(floats, v, dx, dy, dz, vx, vy, vz)
    DOT(floats, all, dx, dy, dz, nx, ny, nz)
    floats sign = all < 0.0f ? (floats)(-1.0f) : (floats)(1.0f);
    u *= sign;
    v *= sign;
    floats rest = sign * all - u - v;
    u = u > 0.0f ? u : (floats)0.0f;
    v = v > 0.0f ? v : (floats)0.0f;
    rest = rest > 0.0f ? rest : (floats)0.0f;
    floats sum = u + v + rest;
    floats inverse = sum > 0.0f ? 1.0f / sum : (floats)0.0f;
    w[0] = u * inverse;
    w[1] = v * inverse;
    inverse *= sign;
    for (int axis = 0; axis < 2; axis++) {
        float rx = view[RAY + 3 * axis], ry = view[RAY + 3 * axis + 1], rz = view[RAY + 3 * axis + 2];
        DOT(floats, step_u, ux, uy, uz, rx, ry, rz)
        DOT(floats, step_v, vx, vy, vz, rx, ry, rz)
        DOT(floats, step, nx, ny, nz, rx, ry, rz)
        w[2 + 2 * axis] = (step_u - w[0] * step) * inverse;
        w[3 + 2 * axis] = (step_v - w[1] * step) * inverse;
    }
}

// The same in double where wide_weights says that it has to be.
void wide_weights_and_steps(__global const float *record, __constant float *view, real px, real py, float *w)
{
    float exact[3];
    if (!wide_weights(record, view, px, py, exact))
        return;
    real o[3], a[3], b[3], step[2][3], d[3];
    int nearest = from_nearest(record, view, o, a, b);
    CROSS(real, ux, uy, uz, o[0], o[1], o[2], b[0], b[1], b[2])
    CROSS(real, vx, vy, vz, a[0], a[1], a[2], o[0], o[1], o[2])
    CROSS(real, nx, ny, nz, b[0], b[1], b[2], a[0], a[1], a[2])
    for (int axis = 0; axis < 3; axis++)
        d[axis] = MAD(px, EXACT_RAY(view, axis), MAD(py, EXACT_RAY(view, 3 + axis), EXACT_RAY(view, 6 + axis)));
    DOT(real, all, d[0], d[1], d[2], nx, ny, nz)
    int next = nearest < 2 ? nearest + 1 : 0, last = nearest > 0 ? nearest - 1 : 2;
    for (int axis = 0; axis < 2; axis++) {
        real rx = EXACT_RAY(view, 3 * axis), ry = EXACT_RAY(view, 3 * axis + 1), rz = EXACT_RAY(view, 3 * axis + 2);
        DOT(real, step_u, ux, uy, uz, rx, ry, rz)
        DOT(real, step_v, vx, vy, vz, rx, ry, rz)
        DOT(real, change, nx, ny, nz, rx, ry, rz)
        step[axis][next] = (step_u - exact[next] * change) / all;
        step[axis][last] = (step_v - exact[last] * change) / all;
        step[axis][nearest] = -step[axis][next] - step[axis][last];
    }
    for (int k = 0; k < 2; k++) {
        w[k] = exact[k + 1];
        w[2 + k] = (float)step[0][k + 1];
        w[4 + k] = (float)step[1][k + 1];
    }
}

// Where textures are read for a sample, and the weights of the second and third corner.
typedef struct {
    Taps near, far;
    int blends; // whether far counts
    floats w0, w1;
} Sight;

// Find where the textures of the faces in `slot` are read at px, py from the principal point, clamped to the faces.
void look(const Textures *t, __constant float *view, ints slot, floats px, floats py, Sight *sight)
{
    floats c[16], w[6];
    EIGHT_WORDS(t->triangles, WORDS, slot, 0, c)
    EIGHT_WORDS(t->triangles, WORDS, slot, 8, (c + 8))
    weights_and_steps(c, view, px, py, w);
    floats size = (floats)0.0f; // as is_long in zbuffer_prepare.cl
    for (int k = 3; k < 9; k++) {
        floats side = c[k] - c[k % 3];
        side = side < 0.0f ? -side : side;
        size = size > side ? size : side;
    }
#if LANES == 8
    int8 reaches_far = size > FAR / 2;
    for (int l = 0; l < 8 && any8(reaches_far); l++) {
        float exact[6];
        for (int k = 0; k < 6; k++)
            exact[k] = PICK_F(w[k], l);
        if (PICK(reaches_far, l))
            wide_weights_and_steps(
                t->triangles + (size_t)PICK(slot, l) * WORDS, view, PICK_F(px, l), PICK_F(py, l), exact);
        for (int k = 0; k < 6; k++)
            ((float *)&w[k])[l] = exact[k];
    }
#else
    if (size > FAR / 2)
        wide_weights_and_steps(t->triangles + (size_t)slot * WORDS, view, px, py, w);
#endif
    floats *uv = c + UV_WORD, *last_uv = c + FACE_WORD + 1;
    floats u1 = uv[2] - uv[0], v1 = last_uv[0] - uv[1], u2 = last_uv[1] - uv[0], v2 = last_uv[2] - uv[1];
    ints row = (ints)FIRST_ROW, width = (ints)t->rows[4 * FIRST_ROW + 1], height = (ints)t->rows[4 * FIRST_ROW + 2];
    ints last_level = (ints)t->rows[4 * FIRST_ROW + 3];
    if (ARE_SEVERAL(t)) {
        row += LEVEL_ROWS * GATHER(ints, t->numbers, slot);
        ints at = 4 * row;
        width = GATHER(ints, t->rows + 1, at);
        height = GATHER(ints, t->rows + 2, at);
        last_level = GATHER(ints, t->rows + 3, at);
    }
    floats lod = (floats)0.0f;
    if (t->rows[1]) {
        floats wide = FLOATS_OF(width), high = FLOATS_OF(height);
        floats last = FLOATS_OF(last_level), texels = (floats)1e-30f;
        for (int axis = 0; axis < 2; axis++) {
            floats x = wide * MAD(w[2 + 2 * axis], u1, w[3 + 2 * axis] * u2);
            floats y = high * MAD(w[2 + 2 * axis], v1, w[3 + 2 * axis] * v2);
            floats squared = y * y;
            squared = MAD(x, x, squared);
            texels = squared > texels ? squared : texels;
        }
        lod = 0.5f * log2_of(texels);
        lod = t->rows[0] ? floor_of(lod + 0.5f) : lod;
        lod = lod > 0.0f ? (lod < last ? lod : last) : (floats)0.0f;
    }
    floats u = folded(MAD(w[0], u1, MAD(w[1], u2, uv[0])), t->rows[2]);
    floats v = folded(MAD(w[0], v1, MAD(w[1], v2, uv[1])), t->rows[3]);
    ints level = INTS_OF(lod);
    floats share = lod - FLOATS_OF(level);
    sight->w0 = w[0];
    sight->w1 = w[1];
    sight->near = taps_of(t, row, level, width, height, u, v, 1.0f - share);
    sight->blends = ANY(share > 0.0f);
    if (sight->blends)
        sight->far = taps_of(t, row, share > 0.0f ? level + 1 : level, width, height, u, v, share);
}

// Linear light and alpha that were looked for.
void show(const Textures *t, ints slot, const Sight *sight, floats *light)
{
    float8 seen[LANES];
    for (int l = 0; l < LANES; l++) {
        seen[l] = blended(t->texels, &sight->near, l);
        if (sight->blends)
            seen[l] += blended(t->texels, &sight->far, l);
        seen[l].lo += seen[l].hi;
    }
#if LANES == 8
    TRANSPOSE(seen[0], seen[1], seen[2], seen[3], seen[4], seen[5], seen[6], seen[7])
    for (int k = 0; k < 4; k++)
        light[k] = seen[k];
#else
    light[0] = seen[0].s0;
    light[1] = seen[0].s1;
    light[2] = seen[0].s2;
    light[3] = seen[0].s3;
#endif
    if (!IS_TINTED(t))
        return;
    floats first[8], last[8];
    EIGHT_WORDS(t->tints, TINT_WORDS, slot, 0, first)
    EIGHT_WORDS(t->tints, TINT_WORDS, slot, 4, last)
    for (int k = 0; k < 4; k++)
        light[k] *= MAD(sight->w0, last[k] - first[k], MAD(sight->w1, last[4 + k] - first[k], first[k]));
}

void surface(const Textures *t, __constant float *view, ints slot, floats px, floats py, floats *light)
{
    Sight sight;
    look(t, view, slot, px, py, &sight);
    show(t, slot, &sight, light);
}
