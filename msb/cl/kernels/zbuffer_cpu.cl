// The opaque z-buffer on a CPU.
// One work-item per processor draws one tile after another.
// The work-item draws eight triangles or eight pixels at once.
// The only atomic is the tile counter.
// docs/standard.md has the rules.
// Corners that faces share are transformed again for each face.
// Fetching nine transformed numbers from scattered addresses would take longer.
// Times on one core of an EPYC (Zen 4), including colouring and reading back: a triangle without samples
// costs 11 ns, a triangle of half a pixel 17 ns, an empty pixel 2 ns, and a covered pixel 7 ns.
//
// The host code defines these sizes (msb/render/standard/renderer.py):
//   CLUSTER   blocks of eight triangles that are culled together
//   GROUP     clusters per group
//   LIST      clusters that are sorted by depth together
//   PAD       columns beyond a tile, for vectors that start inside
//   PAD_ROWS  rows beyond a tile, for 4 x 4 pixels that start inside
#define LANES 8
#define TOUCH
#include "zbuffer_math.cl"
#include "lanes.cl"
#if COLORS == TEXTURES
#include "zbuffer_texture.cl"
#else
#define TEXTURE_ARGUMENTS
#endif
#include "zbuffer_block.cl"

#define BUCKETS 16      // number of depth levels for sorting clusters; more would only scatter the reads
#define LOOK_AFTER 1024 // number of small triangles before the first occlusion measurement

// ---- bounds of clusters of triangles

// Each work-item handles a group of clusters.
// The kernel computes the pixels that the group and each cluster can reach, and 1 / z of their nearest
// points.
// `boxes` has centre and half extent, in six rows of `stride` values.
// `rects` has x0, y0, x1, y1, ends included, in four rows.
// An empty rectangle reaches no pixel.
__kernel void clusters(__global const float *boxes, __constant float *view, __global int *rects,
    __global float *nearest, __global int *group_rects, __global int *next_tile, int count, int stride, int width,
    int height)
{
    int group = get_global_id(0);
    if (group * GROUP >= count)
        return;
    if (group == 0)
        *next_tile = 0;
    int8 left = (int8)(1 << 30), top = left, right = -left, bottom = -left;
    for (int k = group * GROUP; k < MIN(count, group * GROUP + GROUP); k += 8) {
        __global const float *b = boxes + k;
        float8 cx = LOAD(b, 0) - view[CENTER], cy = LOAD(b + stride, 0) - view[CENTER + 1];
        float8 cz = LOAD(b + 2 * stride, 0) - view[CENTER + 2];
        float8 ex = LOAD(b + 3 * stride, 0), ey = LOAD(b + 4 * stride, 0), ez = LOAD(b + 5 * stride, 0);
        // Add slack for rounding errors of the corners.
        float8 slack = 1e-6f * (magnitude(cx) + magnitude(cy) + magnitude(cz) + ex + ey + ez);
        float8 p[3], e[3];
        for (int row = 0; row < 3; row++) {
            float a = view[3 * row], c = view[3 * row + 1], d = view[3 * row + 2];
            p[row] = cx * a + cy * c + cz * d + view[SHIFT + row];
            e[row] = ex * (a < 0 ? -a : a) + ey * (c < 0 ? -c : c) + ez * (d < 0 ? -d : d);
            e[row] += slack * (row < 2 ? view[SCALE + row] : 1.0f);
        }
        // x / z of a box has its extremes at the nearest or farthest z of the box.
        float8 far = p[2] + e[2], near = max8(p[2] - e[2], (float8)NEAR);
        float8 far_q = 1.0f / far, near_q = 1.0f / near;
        int8 edge[4];
        for (int side = 0; side < 4; side++) {
            float8 along = side < 2 ? p[side] - e[side] : p[side - 2] + e[side - 2];
            int8 outwards = side < 2 ? along < 0.0f : along > 0.0f;
            float8 units = along * (outwards ? near_q : far_q) + view[PRINCIPAL + (side & 1)];
            float8 pixel = units * (1.0f / UNIT) + (side < 2 ? -1.0f : 1.0f);
            edge[side] = TO_INT(min8(max8(pixel, (float8)(-2.0f)), (float8)(100000.0f)));
        }
        int8 x0 = max8i(edge[0], (int8)0), y0 = max8i(edge[1], (int8)0);
        int8 x1 = min8i(edge[2], (int8)(width - 1)), y1 = min8i(edge[3], (int8)(height - 1));
        int8 dead = ~(far >= NEAR) | (x0 > x1) | (y0 > y1) | (k + (int8)(0, 1, 2, 3, 4, 5, 6, 7) >= count);
        x0 = dead ? (int8)(1 << 30) : x0;
        y0 = dead ? (int8)(1 << 30) : y0;
        x1 = dead ? (int8)(-1) : x1;
        y1 = dead ? (int8)(-1) : y1;
        *(__global loose_int8 *)(rects + k) = x0;
        *(__global loose_int8 *)(rects + stride + k) = y0;
        *(__global loose_int8 *)(rects + 2 * stride + k) = x1;
        *(__global loose_int8 *)(rects + 3 * stride + k) = y1;
        *(__global loose_float8 *)(nearest + k) = near_q * 1.00001f;
        left = min8i(left, x0);
        top = min8i(top, y0);
        right = max8i(right, x1);
        bottom = max8i(bottom, y1);
    }
    int4 all = (int4)(left.s0, top.s0, right.s0, bottom.s0);
    for (int l = 1; l < 8; l++) {
        all.x = MIN(all.x, PICK(left, l));
        all.y = MIN(all.y, PICK(top, l));
        all.z = MAX(all.z, PICK(right, l));
        all.w = MAX(all.w, PICK(bottom, l));
    }
    ((__global int4 *)group_rects)[group] = all;
}

// ---- colours

typedef struct {
    __global float *image, *depth, *alpha;
    __global int *faces;
    int all; // write all output planes, not only the image
} Output;

#if COLORS == TEXTURES
#define SIGHTS 32 // groups of eight pixels in a row of the widest tile

// Find the texture positions for one pixel row of a tile, and prefetch the texels. The steps are long
// dependency chains. Each step is done for the whole row, so that the processor overlaps several chains.
void look_ahead(const Tile *t, __constant float *view, int y, Place *places, Sight *sights)
{
    const float8 lane = (float8)(0, 1, 2, 3, 4, 5, 6, 7);
    __global const float *depth = t->depth + (y - t->y0) * t->stride;
    __global const int *slots = t->slot + (y - t->y0) * t->stride;
    int width = t->x1 - t->x0;
    for (int x = 0; x < width; x++)
        PREFETCH(t->triangles + (size_t)slots[x] * WORDS);
    float8 py = (float8)((float)y + 0.5f - view[OPTICAL + 1]);
    for (int x = 0; x < width; x += 8) {
        int8 hit = LOAD(depth + x, 0) > 0.0f, slot = LOAD_INT(slots + x) & hit;
        if (any8(hit))
            look(&t->textures, view, slot, (float)(t->x0 + x) + lane + 0.5f - view[OPTICAL], py, places + x / 8);
    }
    for (int x = 0; x < width; x += 8) {
        int8 hit = LOAD(depth + x, 0) > 0.0f, slot = LOAD_INT(slots + x) & hit;
        if (!any8(hit))
            continue;
        Sight *sight = sights + x / 8;
        aim(&t->textures, slot, places + x / 8, sight);
#pragma unroll
        for (int l = 0; l < 8; l++) {
            __global const ushort4 *four = t->textures.texels + PICK(sight->near.at, l);
            PREFETCH(four);
            PREFETCH(four + PICK(sight->near.below, l));
        }
        if (sight->blends)
#pragma unroll
            for (int l = 0; l < 8; l++) {
                __global const ushort4 *four = t->textures.texels + PICK(sight->far.at, l);
                PREFETCH(four);
                PREFETCH(four + PICK(sight->far.below, l));
            }
    }
}
#endif

void shade(const Tile *t, __constant float *view, __global const float *colors, Output out, int width,
    float3 background)
{
    const float8 lane = (float8)(0, 1, 2, 3, 4, 5, 6, 7);
#if COLORS == TEXTURES
    Place places[SIGHTS];
    Sight sights[SIGHTS];
#endif
    for (int y = t->y0; y < t->y1; y++) {
        float py = (float)y + 0.5f - view[OPTICAL + 1];
#if COLORS == TEXTURES
        look_ahead(t, view, y, places, sights);
#endif
        for (int x = t->x0; x < t->x1; x += 8) {
            int at = (y - t->y0) * t->stride + x - t->x0;
            float8 depth = LOAD(t->depth + at, 0);
            int8 hit = depth > 0.0f, face = (int8)NO_FACE, slot = LOAD_INT(t->slot + at) & hit;
            float8 red = (float8)background.x, green = (float8)background.y, blue = (float8)background.z;
            if (any8(hit)) {
                float8 r, g, b;
#if COLORS == TEXTURES
                if (out.all)
                    face = hit ? GATHER(int8, INTEGERS(t->triangles) + FACE_WORD, slot * WORDS) : face;
                float8 light[4];
                show(&t->textures, slot, places + (x - t->x0) / 8, sights + (x - t->x0) / 8, light);
                r = encoded(light[0]);
                g = encoded(light[1]);
                b = encoded(light[2]);
#else
                __global const float *r0 = t->triangles + (size_t)slot.s0 * WORDS;
                __global const float *r1 = t->triangles + (size_t)slot.s1 * WORDS;
                __global const float *r2 = t->triangles + (size_t)slot.s2 * WORDS;
                __global const float *r3 = t->triangles + (size_t)slot.s3 * WORDS;
                __global const float *r4 = t->triangles + (size_t)slot.s4 * WORDS;
                __global const float *r5 = t->triangles + (size_t)slot.s5 * WORDS;
                __global const float *r6 = t->triangles + (size_t)slot.s6 * WORDS;
                __global const float *r7 = t->triangles + (size_t)slot.s7 * WORDS;
                float8 d0 = LOAD(r0, 1), d1 = LOAD(r1, 1), d2 = LOAD(r2, 1), d3 = LOAD(r3, 1);
                float8 d4 = LOAD(r4, 1), d5 = LOAD(r5, 1), d6 = LOAD(r6, 1), d7 = LOAD(r7, 1);
                TRANSPOSE(d0, d1, d2, d3, d4, d5, d6, d7)
                face = hit ? as_int8(d4) : face;
#if COLORS == FLOATS_OF_FACE
                r = d1;
                g = d2;
                b = d3;
#else
                float8 c0 = LOAD(r0, 0), c1 = LOAD(r1, 0), c2 = LOAD(r2, 0), c3 = LOAD(r3, 0);
                float8 c4 = LOAD(r4, 0), c5 = LOAD(r5, 0), c6 = LOAD(r6, 0), c7 = LOAD(r7, 0);
                TRANSPOSE(c0, c1, c2, c3, c4, c5, c6, c7)
                float8 px = (float)x + lane + 0.5f - view[OPTICAL];
                WEIGHTS(float8, view, c0, c1, c2, c3, c4, c5, c6, c7, d0, px, py, w0, w1, w2)
                int8 reaches_far = as_int8(d5) & hit;
                for (int l = 0; l < 8 && any8(reaches_far); l++) {
                    float exact[3];
                    if (!PICK(reaches_far, l)
                        || !wide_weights(t->triangles + (size_t)PICK(slot, l) * WORDS, view, PICK_F(px, l), py, exact))
                        continue;
                    ((float *)&w0)[l] = exact[0];
                    ((float *)&w1)[l] = exact[1];
                    ((float *)&w2)[l] = exact[2];
                }
#if COLORS == BYTES_OF_CORNERS
                int8 k0 = as_int8(d1), k1 = as_int8(d2), k2 = as_int8(d3);
#define BYTE(k, shift) TO_FLOAT((k >> shift) & 255)
                w0 *= 1.0f / 255.0f;
                w1 *= 1.0f / 255.0f;
                w2 *= 1.0f / 255.0f;
                MIX(float8, r, w0, BYTE(k0, 0), w1, BYTE(k1, 0), w2, BYTE(k2, 0))
                MIX(float8, g, w0, BYTE(k0, 8), w1, BYTE(k1, 8), w2, BYTE(k2, 8))
                MIX(float8, b, w0, BYTE(k0, 16), w1, BYTE(k1, 16), w2, BYTE(k2, 16))
#else
                __global const float *k0 = colors + (size_t)slot.s0 * 9, *k1 = colors + (size_t)slot.s1 * 9;
                __global const float *k2 = colors + (size_t)slot.s2 * 9, *k3 = colors + (size_t)slot.s3 * 9;
                __global const float *k4 = colors + (size_t)slot.s4 * 9, *k5 = colors + (size_t)slot.s5 * 9;
                __global const float *k6 = colors + (size_t)slot.s6 * 9, *k7 = colors + (size_t)slot.s7 * 9;
                float8 s0 = LOAD(k0, 0), s1 = LOAD(k1, 0), s2 = LOAD(k2, 0), s3 = LOAD(k3, 0);
                float8 s4 = LOAD(k4, 0), s5 = LOAD(k5, 0), s6 = LOAD(k6, 0), s7 = LOAD(k7, 0);
                float8 s8 = (float8)(k0[8], k1[8], k2[8], k3[8], k4[8], k5[8], k6[8], k7[8]);
                TRANSPOSE(s0, s1, s2, s3, s4, s5, s6, s7)
                MIX(float8, r, w0, s0, w1, s3, w2, s6)
                MIX(float8, g, w0, s1, w1, s4, w2, s7)
                MIX(float8, b, w0, s2, w1, s5, w2, s8)
#endif
                r = min8(r, (float8)1.0f);
                g = min8(g, (float8)1.0f);
                b = min8(b, (float8)1.0f);
#endif
#endif
                red = hit ? r : red;
                green = hit ? g : green;
                blue = hit ? b : blue;
            }
            size_t pixel = (size_t)y * width + x;
            __global float *image = out.image + 3 * pixel;
            float8 rgb[3];
            rgb[0] = (float8)(red.s0, green.s0, blue.s0, red.s1, green.s1, blue.s1, red.s2, green.s2);
            rgb[1] = (float8)(blue.s2, red.s3, green.s3, blue.s3, red.s4, green.s4, blue.s4, red.s5);
            rgb[2] = (float8)(green.s5, blue.s5, red.s6, green.s6, blue.s6, red.s7, green.s7, blue.s7);
            float8 z = hit ? 1.0f / depth : (float8)0.0f, alpha = hit ? (float8)1.0f : (float8)0.0f;
            int n = t->x1 - x;
            if (n >= 8) {
                for (int k = 0; k < 3; k++)
                    *(__global loose_float8 *)(image + 8 * k) = rgb[k];
                if (out.all) {
                    *(__global loose_float8 *)(out.depth + pixel) = z;
                    *(__global loose_float8 *)(out.alpha + pixel) = alpha;
                    *(__global loose_int8 *)(out.faces + pixel) = face;
                }
                continue;
            }
            for (int k = 0; k < 3 * n; k++)
                image[k] = ((float *)rgb)[k];
            for (int k = 0; k < n && out.all; k++) {
                out.depth[pixel + k] = PICK_F(z, k);
                out.alpha[pixel + k] = PICK_F(alpha, k);
                out.faces[pixel + k] = PICK(face, k);
            }
        }
    }
}

// ---- the image

// Draw the clusters of `list` that reach the tile, from near to far.
// The array `list` has memory for 2 n entries.
void draw_list(Tile *t, __global int *list, int n, __global const int *rects, __global const float *nearest,
    int stride, int blocks, __constant float *view)
{
    // the bits of positive floats compare in the order of their values
    __global const int *bits = (__global const int *)nearest;
    int low = 0x7fffffff, high = 0, shift = 0, starts[BUCKETS + 1];
    for (int i = 0; i < n; i++) {
        low = MIN(low, bits[list[i]]);
        high = MAX(high, bits[list[i]]);
    }
    while ((high - low) >> shift >= BUCKETS)
        shift++;
    for (int i = 0; i <= BUCKETS; i++)
        starts[i] = 0;
    for (int i = 0; i < n; i++)
        starts[((high - bits[list[i]]) >> shift) + 1]++;
    for (int i = 0; i < BUCKETS; i++)
        starts[i + 1] += starts[i];
    __global int *sorted = list + LIST;
    for (int i = 0; i < n; i++)
        sorted[starts[(high - bits[list[i]]) >> shift]++] = list[i];
    // Drawing lags one cluster behind the loop, so that triangles are prefetched in time.
    int waiting = -1;
    for (int i = 0; i <= n; i++) {
        int k = i < n ? sorted[i] : -1;
        if (i < n) {
            int x0 = MAX(rects[k], t->x0), y0 = MAX(rects[stride + k], t->y0);
            int x1 = MIN(rects[2 * stride + k], t->x1 - 1), y1 = MIN(rects[3 * stride + k], t->y1 - 1);
            if (t->occludes && hidden(t, x0, y0, x1, y1, nearest[k]))
                continue;
            for (int line = 0; line < 8 * CLUSTER; line++)
                PREFETCH(t->triangles + ((size_t)k * (8 * CLUSTER) + line) * WORDS);
        }
        if (waiting >= 0) {
            for (int b = waiting * CLUSTER; b < MIN((waiting + 1) * CLUSTER, blocks); b++)
                draw_block(t, b, view);
            t->work += 8 * CLUSTER;
            if (t->work >= t->limit)
                measure(t);
        }
        waiting = k;
    }
}

// The kernel has one work-item per processor.
// For each work-item, `scratch` holds the two planes of a tile, its coarse depths and two lists.
// The scratch memory of a work-item has `scratch_words` words.
__kernel void tiles(__global const float *triangles, __global const float *colors, __constant float *view,
    __global const int *rects, __global const float *nearest, __global const int *group_rects, int count, int stride,
    int blocks, int width, int height, int tile_width, int tile_height, __global int *next_tile,
    __global float *scratch, int scratch_words, __global float *image, __global float *depth, __global float *alpha,
    __global int *faces, int all, float4 background TEXTURE_ARGUMENTS)
{
    Output out = {image, depth, alpha, faces, all};
    int columns = (width + tile_width - 1) / tile_width, rows = (height + tile_height - 1) / tile_height;
    Tile tile, *t = &tile;
    t->triangles = triangles;
#if COLORS == TEXTURES
    Textures textures = TEXTURES_OF(triangles, colors);
    t->textures = textures;
#endif
    t->stride = tile_width + PAD;
    int area = t->stride * (tile_height + PAD_ROWS);
    t->depth = scratch + (size_t)get_global_id(0) * scratch_words;
    t->slot = (__global int *)(t->depth + area);
    t->far = t->depth + 2 * area;
    __global int *list = (__global int *)(t->far + COARSE_ROW * COARSE_ROW);
    for (;;) {
        int index = atomic_inc(next_tile);
        if (index >= columns * rows)
            return;
        t->x0 = index % columns * tile_width;
        t->y0 = index / columns * tile_height;
        t->x1 = MIN(t->x0 + tile_width, width);
        t->y1 = MIN(t->y0 + tile_height, height);
        t->occludes = 0;
        for (int i = 0; i < area; i += 4)
            *(__global float4 *)(t->depth + i) = (float4)0.0f;
        t->work = 0;
        t->limit = LOOK_AFTER;
        int n = 0;
        for (int first = 0; first < count; first += GROUP) {
            int4 all_of = ((__global const int4 *)group_rects)[first / GROUP];
            if (all_of.x < t->x1 && all_of.y < t->y1 && all_of.z >= t->x0 && all_of.w >= t->y0)
                for (int k = first; k < MIN(first + GROUP, count); k += 8) {
                    int reaching = bits8((LOAD_INT(rects + k) < t->x1) & (LOAD_INT(rects + stride + k) < t->y1)
                        & (LOAD_INT(rects + 2 * stride + k) >= t->x0) & (LOAD_INT(rects + 3 * stride + k) >= t->y0));
                    for (; reaching; reaching &= reaching - 1)
                        list[n++] = k + LOWEST_BIT(reaching);
                }
            if (n > LIST - GROUP || first + GROUP >= count) {
                draw_list(t, list, n, rects, nearest, stride, blocks, view);
                n = 0;
            }
        }
        shade(t, view, colors, out, width, background.xyz);
    }
}
