// Textures for the opaque z-buffer: the colour of a face at one sample or at eight samples (LANES 8).
// docs/standard.md has the rules; `sample` in msb/asset/texture.py is a readable version in NumPy.
//
// A triangle record has u, v of its corners in UV_WORD and after FACE_WORD.
// `tints`, if used, holds linear light and alpha of the corners of each slot.
// With several textures, `numbers` holds the texture of each slot.
// `texels` holds all levels of all textures, each with an extra column and row.
// A texel is linear light and alpha, with 16 bits each.
// The rows of the table `rows`:
//   row 0       whether the nearest texel is used, whether smaller levels are used, wrap of u, wrap of v
//   row 1       alpha cutoff as a float; whether there are tints; whether there are several textures
//   row 2 + 5t  texture t: width, height, last level; the next four rows: first texels of levels 0 to 15

// msb/render/standard/texels.py defines FIRST_ROW, TEXTURE_ROWS and the wrap modes CLAMPED and MIRRORED.
// All other values of a wrap mode mean repeat.
#define TINT_WORDS 12
// Inlining moves values that are constant along a row out of the loops.
#if LANES == 8 && defined(__clang__)
#define INLINED __attribute__((always_inline))
#else
#define INLINED
#endif
#if CUTOFF
#define SEEN 4 // number of channels
#else
#define SEEN 3
#endif

typedef struct {
    __global const float *triangles, *tints;
    __global const uint *numbers;
    __global const ushort4 *texels;
    __global const int *rows;
} Textures;
#define CUTOFF_OF(t) as_float((t)->rows[4])
#define IS_TINTED(t) ((t)->rows[5])
#define ARE_SEVERAL(t) ((t)->rows[6])
// Texture arguments of a drawing kernel, and the struct that holds them.
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
#define MAGNITUDE(x) magnitude(x)
#define ANY(mask) any8(mask)
#define GATHER(type, p, i)                                                                                      \
    (type)((p)[(i).s0], (p)[(i).s1], (p)[(i).s2], (p)[(i).s3], (p)[(i).s4], (p)[(i).s5], (p)[(i).s6], (p)[(i).s7])
#define ROW_OF(p, words, slot, lane, i) LOAD((p) + (size_t)(slot).s##lane * (words) + (i), 0)
// Loads words i to i + 7 of eight records.
#define EIGHT_WORDS(p, words, slot, i, w)                                                                       \
    {                                                                                                           \
        w[0] = ROW_OF(p, words, slot, 0, i), w[1] = ROW_OF(p, words, slot, 1, i);                               \
        w[2] = ROW_OF(p, words, slot, 2, i), w[3] = ROW_OF(p, words, slot, 3, i);                               \
        w[4] = ROW_OF(p, words, slot, 4, i), w[5] = ROW_OF(p, words, slot, 5, i);                               \
        w[6] = ROW_OF(p, words, slot, 6, i), w[7] = ROW_OF(p, words, slot, 7, i);                               \
        COLUMNS(w)                                                                                              \
    }
typedef ushort8 __attribute__((aligned(8))) loose_ushort8;
#define TWO_TEXELS(p) TO_FLOAT(*(__global const loose_ushort8 *)(p))
#define COLUMNS(w) TRANSPOSE(w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7])
#define COLUMN(w, k) (w)[k]
#define ONE_OF_16(p, i) one_of_16(p, i)
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
#define MAGNITUDE(x) fabs(x)
#define ANY(mask) (mask)
#define GATHER(type, p, i) (type)((p)[i])
#define EIGHT_WORDS(p, words, slot, i, w)                                                                       \
    for (int word = 0; word < 8; word++)                                                                        \
        w[word] = (p)[(size_t)(slot) * (words) + (i) + word];
#define TWO_TEXELS(p) convert_float8((ushort8)((p)[0], (p)[1]))
#define COLUMNS(w)
#define COLUMN(w, k) ((const float *)(w))[k]
#define ONE_OF_16(p, i) (p)[i]
#define ROOT(x) sqrt(x)
#define LANE(v, l) (v)
#define LANE_F(v, l) (v)
#endif

#ifndef FLOOR
#define FLOOR(x) floor_of(x)
#endif
floats floor_of(floats x)
{
    floats whole = FLOATS_OF(INTS_OF(x));
    whole = whole > x ? whole - 1.0f : whole;
    return x < 8388608.0f ? (x > -8388608.0f ? whole : x) : x; // floats above this value are integers
}

// This is a polynomial in the mantissa minus 1, with the mantissa in [sqrt(1/2), sqrt(2)).
// The result is accurate to 3e-6 for positive normal numbers.
floats log2_of(floats x)
{
    ints bits = AS_INTS(x), exponent = (bits - 0x3f3504f3) >> 23;
    floats t = AS_FLOATS(bits - (exponent << 23)) - 1.0f, square = t * t;
    floats high = MAD(square, MAD(t, (floats)(-0.20659133f), (floats)0.32215469f),
        MAD(t, (floats)(-0.36749004f), (floats)0.47934803f));
    floats low = MAD(square, high, MAD(t, (floats)(-0.72113186f), (floats)1.44271348f));
    return MAD(t, low, FLOATS_OF(exponent));
}

// Linear light to sRGB (IEC 61966-2-1).
// Above the linear part, a polynomial in the fourth root is accurate to 2e-6.
floats encoded(floats x)
{
    floats root = ROOT(ROOT(x));
    floats curve = MAD(root, (floats)0.06820814f, (floats)(-0.31841745f));
    curve = MAD(root, curve, (floats)0.65719179f);
    curve = MAD(root, curve, (floats)(-0.85296119f));
    curve = MAD(root, curve, (floats)1.36592304f);
    curve = MAD(root, curve, (floats)0.13960362f);
    curve = MAD(root, curve, (floats)(-0.05954656f));
    floats result = x > 0.0031308f ? curve : 12.92f * x;
    return result < 1.0f ? result : (floats)1.0f;
}

// Map a texture coordinate into the texture, 0 to 1, according to the wrap mode.
floats folded(floats u, int wrap)
{
    if (wrap == MIRRORED) {
        u -= 2.0f * FLOOR(0.5f * u);
        u = u > 1.0f ? 2.0f - u : u;
    } else if (wrap != CLAMPED)
        u -= FLOOR(u);
    return u > 0.0f ? (u < 1.0f ? u : (floats)1.0f) : (floats)0.0f;
}

// Values of the textures of the faces in `slot`: row offset from the first texture, sides, and last level.
typedef struct {
    ints at, width, height, last_level;
} Image;

Image image_of(const Textures *t, ints slot)
{
    __global const int *rows = t->rows + 4 * FIRST_ROW;
    Image image = {0, rows[0], rows[1], rows[2]};
    if (ARE_SEVERAL(t)) {
        image.at = 4 * TEXTURE_ROWS * GATHER(ints, t->numbers, slot);
        image.width = GATHER(ints, rows, image.at);
        image.height = GATHER(ints, rows + 1, image.at);
        image.last_level = GATHER(ints, rows + 2, image.at);
    }
    return image;
}

// The texels read in a level: the upper left texel of four, and the offset to the lower two texels. Three
// weights follow: for the upper texels, for the lower texels, and for the right texel in each pair.
typedef struct {
    ints at, below;
    floats upper, lower, right;
} Taps;

// The weighted texels of a level, times a share; u, v are already mapped into the texture.
// Each level has an extra column and row, which hold the neighbours of the last texels. The four texels are
// therefore always neighbours.
Taps taps_of(const Textures *t, const Image *image, ints level, floats u, floats v, floats share)
{
    Taps taps;
    __global const int *firsts = t->rows + 4 * (FIRST_ROW + 1);
    ints at = image->at + level, first = ARE_SEVERAL(t) ? GATHER(ints, firsts, at) : ONE_OF_16(firsts, level);
    ints width = image->width >> level, height = image->height >> level;
    width = width > 1 ? width : (ints)1;
    height = height > 1 ? height : (ints)1;
    ints x0, y0;
    share *= 1.0f / 65535.0f;
    if (t->rows[0]) { // if the nearest texel is used, it is the upper left of four
        x0 = INTS_OF(u * FLOATS_OF(width));
        y0 = INTS_OF(v * FLOATS_OF(height));
        x0 = x0 < width ? x0 : width - 1;
        y0 = y0 < height ? y0 : height - 1;
        taps.right = taps.lower = (floats)0.0f;
    } else {
        floats x = MAD(u, FLOATS_OF(width), (floats)(-0.5f));
        floats y = MAD(v, FLOATS_OF(height), (floats)(-0.5f));
        // Beyond the edge of a texture that does not repeat, the colour of the edge continues.
        if (t->rows[2] != 0)
            x = x > 0.0f ? x : (floats)0.0f;
        if (t->rows[3] != 0)
            y = y > 0.0f ? y : (floats)0.0f;
        floats left = FLOOR(x), up = FLOOR(y);
        taps.right = x - left;
        taps.lower = share * (y - up);
        x0 = INTS_OF(left);
        y0 = INTS_OF(up);
        x0 = x0 < 0 ? width - 1 : x0;
        y0 = y0 < 0 ? height - 1 : y0;
    }
    taps.upper = share - taps.lower;
    taps.below = width + 1;
    taps.at = first + y0 * taps.below + x0;
    return taps;
}

// Add the colour of the weighted texels.
INLINED void add_taps(__global const ushort4 *texels, const Taps *taps, floats *light)
{
    float8 seen[LANES]; // left texels first, then right texels
#pragma unroll
    for (int l = 0; l < LANES; l++) {
        __global const ushort4 *four = texels + LANE(taps->at, l);
        float8 lower = TWO_TEXELS(four + LANE(taps->below, l)) * LANE_F(taps->lower, l);
        seen[l] = MAD(TWO_TEXELS(four), (float8)LANE_F(taps->upper, l), lower);
    }
    COLUMNS(seen)
#pragma unroll
    for (int k = 0; k < SEEN; k++)
        light[k] += MAD(taps->right, COLUMN(seen, k + 4) - COLUMN(seen, k), COLUMN(seen, k));
}

// Weights of the second and third corner at a sample, and the steps of these weights per pixel along x and y.
// The order is w[0], w[1], w[0] along x, w[1] along x, w[0] along y, w[1] along y.
// Computes the weights with the formula of the macro WEIGHTS. The volumes are products of the ray with
// constant vectors of the face. The steps of the volumes follow from the steps of the ray.
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
#pragma unroll
    for (int axis = 0; axis < 2; axis++) {
        float rx = view[RAY + 3 * axis], ry = view[RAY + 3 * axis + 1], rz = view[RAY + 3 * axis + 2];
        DOT(floats, step_u, ux, uy, uz, rx, ry, rz)
        DOT(floats, step_v, vx, vy, vz, rx, ry, rz)
        DOT(floats, step, nx, ny, nz, rx, ry, rz)
        w[2 + 2 * axis] = (step_u - w[0] * step) * inverse;
        w[3 + 2 * axis] = (step_v - w[1] * step) * inverse;
    }
}

// Computes the weights in double precision if wide_weights requires this.
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

// The texture position of a sample, from 0 to 1, the level, and the weights of the second and third corner.
typedef struct {
    floats u, v, lod, w0, w1;
} Place;

// Find the texture position of the faces in `slot` at px, py, clamped to the faces.
// px and py are relative to the principal point.
INLINED void look(const Textures *t, __constant float *view, ints slot, floats px, floats py, Place *place)
{
    floats c[16], w[6];
    EIGHT_WORDS(t->triangles, WORDS, slot, 0, c)
    EIGHT_WORDS(t->triangles, WORDS, slot, 8, (c + 8))
    weights_and_steps(c, view, px, py, w);
    floats size = (floats)0.0f; // same test as is_long in zbuffer_math.cl
#pragma unroll
    for (int k = 3; k < 9; k++) {
        floats side = MAGNITUDE(c[k] - c[k % 3]);
        size = size > side ? size : side;
    }
#if LANES == 8
    int8 reaches_far = size > FAR / 2;
    for (int l = 0; l < 8 && any8(reaches_far); l++) {
        float exact[6];
#pragma unroll
        for (int k = 0; k < 6; k++)
            exact[k] = PICK_F(w[k], l);
        if (PICK(reaches_far, l))
            wide_weights_and_steps(
                t->triangles + (size_t)PICK(slot, l) * WORDS, view, PICK_F(px, l), PICK_F(py, l), exact);
#pragma unroll
        for (int k = 0; k < 6; k++)
            ((float *)&w[k])[l] = exact[k];
    }
#else
    if (size > FAR / 2)
        wide_weights_and_steps(t->triangles + (size_t)slot * WORDS, view, px, py, w);
#endif
    floats *uv = c + UV_WORD, *last_uv = c + FACE_WORD + 1;
    floats u1 = uv[2] - uv[0], v1 = last_uv[0] - uv[1], u2 = last_uv[1] - uv[0], v2 = last_uv[2] - uv[1];
    floats lod = (floats)0.0f;
    if (t->rows[1]) {
        Image image = image_of(t, slot);
        floats wide = FLOATS_OF(image.width), high = FLOATS_OF(image.height);
        floats last = FLOATS_OF(image.last_level), texels = (floats)1e-30f;
#pragma unroll
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
    place->u = folded(MAD(w[0], u1, MAD(w[1], u2, uv[0])), t->rows[2]);
    place->v = folded(MAD(w[0], v1, MAD(w[1], v2, uv[1])), t->rows[3]);
    place->lod = lod;
    place->w0 = w[0];
    place->w1 = w[1];
}

// The weighted texels at a texture position, in one level or two.
typedef struct {
    Taps near, far;
    int blends; // whether `far` counts
} Sight;

INLINED void aim(const Textures *t, ints slot, const Place *place, Sight *sight)
{
    Image image = image_of(t, slot);
    ints level = INTS_OF(place->lod);
    floats share = place->lod - FLOATS_OF(level);
    sight->near = taps_of(t, &image, level, place->u, place->v, 1.0f - share);
    sight->blends = ANY(share > 0.0f);
    level = level < image.last_level ? level + 1 : level;
    if (sight->blends)
        sight->far = taps_of(t, &image, level, place->u, place->v, share);
}

// Returns the linear light at a texture position, and, with a cutoff, the alpha.
INLINED void show(const Textures *t, ints slot, const Place *place, const Sight *sight, floats *light)
{
#pragma unroll
    for (int k = 0; k < SEEN; k++)
        light[k] = (floats)0.0f;
    add_taps(t->texels, &sight->near, light);
    if (sight->blends)
        add_taps(t->texels, &sight->far, light);
    if (!IS_TINTED(t))
        return;
    floats first[8], last[8];
    EIGHT_WORDS(t->tints, TINT_WORDS, slot, 0, first)
    EIGHT_WORDS(t->tints, TINT_WORDS, slot, 4, last)
#pragma unroll
    for (int k = 0; k < SEEN; k++)
        light[k] *= MAD(place->w0, last[k] - first[k], MAD(place->w1, last[4 + k] - first[k], first[k]));
}

void surface(const Textures *t, __constant float *view, ints slot, floats px, floats py, floats *light)
{
    Place place;
    Sight sight;
    look(t, view, slot, px, py, &place);
    aim(t, slot, &place, &sight);
    show(t, slot, &place, &sight, light);
}
