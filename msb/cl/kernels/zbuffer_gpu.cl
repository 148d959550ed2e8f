// The opaque z-buffer on a GPU.
// First, one work-item per triangle uses atomics on pixels.
// After that, one work-item shades each pixel.
// Triangles that would occupy a work-item for long are listed and drawn by whole work-groups.
// The arithmetic and the image are the same as on a CPU (zbuffer_math.cl).
//
// A pixel has 64 bits: 1 / z in the upper half, the complement of the slot in the lower half.
// The larger value is nearer and, at equal depths, has the lower slot.
// On a GPU, slots are in face order.
// Without 64-bit atomics (KEYS 0) the triangles are drawn twice.
// The first pass finds depths, and the second pass finds the slots of triangles at these depths.
#define LANES 1
#include "zbuffer_math.cl"
#if COLORS == TEXTURES
#include "zbuffer_texture.cl"
#define DRAWN_TEXTURES , __global const float *corners TEXTURE_ARGUMENTS
#define IN_TARGET , TEXTURES_OF(records, corners)
#else
#define TEXTURE_ARGUMENTS
#define DRAWN_TEXTURES
#define IN_TARGET
#endif

#if KEYS
#pragma OPENCL EXTENSION cl_khr_int64_extended_atomics : enable
#endif

#define SMALL 64     // maximum box, in pixels, that one work-item draws
#define MEDIUM 16384 // maximum box, in pixels, that one work-group draws

typedef struct {
    __global uint *pixels; // complement of the slot, then depth: the halves of a little-endian 64-bit key
    int width, height, pass;
#if COLORS == TEXTURES
    Textures textures;
#endif
} Target;

#if COLORS == TEXTURES && CUTOFF
// Returns whether the texture alpha at a sample reaches the cutoff.
int is_there(const Target *t, int x, int y, uint slot, __constant float *view)
{
    float light[4], px = (float)x + 0.5f - view[OPTICAL], py = (float)y + 0.5f - view[OPTICAL + 1];
    surface(&t->textures, view, (int)slot, px, py, light);
    return !(light[3] < CUTOFF_OF(&t->textures));
}
#define IS_THERE(t, x, y, slot, view) is_there(t, x, y, slot, view)
#else
#define IS_THERE(t, x, y, slot, view) 1
#endif

void hit(const Target *t, int x, int y, float depth, uint slot, __constant float *view)
{
    __global uint *pixel = t->pixels + 2 * ((size_t)y * t->width + x);
#if KEYS
    ulong key = (ulong)as_uint(depth) << 32 | ~slot;
    __global ulong *place = (__global ulong *)pixel;
    // Keys only grow, so an earlier read suffices to reject a pixel.
    // This test rejects most hidden pixels.
    if (key > *(volatile __global ulong *)place && IS_THERE(t, x, y, slot, view))
        atom_max(place, key);
#else
    if (t->pass == 0) {
        if (IS_THERE(t, x, y, slot, view))
            atomic_max(pixel + 1, as_uint(depth));
    } else if (pixel[1] == as_uint(depth) && IS_THERE(t, x, y, slot, view))
        atomic_max(pixel, ~slot);
#endif
}

// Draw every `step`-th pixel of the box of the triangle in every `row_step`-th row.
void fill(const Target *t, const Outline *o, const Edges *s, uint slot, __constant float *view, int start, int step,
    int row, int row_step)
{
    for (int y = s->y0 + row; y <= s->y1; y += row_step) {
        long down = y - s->y0;
        float v = (float)((y << SUBPIXEL_BITS) + HALF - o->v_reference);
        float along = MAD(o->b, v, o->reference);
        for (int x = s->x0 + start; x <= s->x1; x += step) {
            long right = x - s->x0;
            long e0 = s->e[0] + down * s->dx[0] - right * s->dy[0];
            long e1 = s->e[1] + down * s->dx[1] - right * s->dy[1];
            long e2 = s->e[2] + down * s->dx[2] - right * s->dy[2];
            if ((e0 | e1 | e2) < 0)
                continue;
            float depth = MAD(o->a, (float)((x << SUBPIXEL_BITS) + HALF - o->u_reference), along);
            if (o->wide)
                depth = wide_depth(o, x, y, view);
            depth = depth > o->low ? depth : o->low;
            depth = depth < o->high ? depth : o->high;
            hit(t, x, y, depth, slot, view);
        }
    }
}

__kernel void clear(__global uint2 *pixels, __global int *listed, uint count)
{
    size_t i = get_global_id(0);
    if (i < 2)
        listed[i] = 0;
    if (i < count)
        pixels[i] = (uint2)0;
}

// The kernel has one work-item per triangle.
// `list` gets the slots for `listed_triangles`.
// Triangles for one work-group fill the list from the front, and triangles for several work-groups from the
// end. `listed` has the counts of both kinds of triangles.
__kernel void triangles(__global const float *records, __constant float *view, __global uint *pixels,
    __global uint *list, __global int *listed, uint slots, int width, int height, int pass DRAWN_TEXTURES)
{
    Target t = {pixels, width, height, pass IN_TARGET};
    size_t slot = get_global_id(0);
    if (slot >= slots)
        return;
    Outline o = make_outline(records + slot * WORDS, view);
    if (o.n < 3)
        return;
    Edges s = make_edges(&o, 1, 0, 0, width, height);
    long box = 0;
    if (s.x0 <= s.x1 && s.y0 <= s.y1)
        box = (long)(s.x1 - s.x0 + 1) * (s.y1 - s.y0 + 1);
    if (o.n == 3 && box <= SMALL) {
        if (box)
            fill(&t, &o, &s, (uint)slot, view, 0, 1, 0, 1);
    } else if (pass == 0) {
        if (o.n == 3 && box <= MEDIUM)
            list[atomic_inc(listed)] = (uint)slot;
        else
            list[slots - 1 - atomic_inc(listed + 1)] = (uint)slot;
    }
}

// Work-groups of 8 x 8 pixels share the listed triangles.
// If `many` is 0, each work-group takes whole triangles.
// If `many` is 1, the groups along the second dimension share a triangle.
// Each group takes 8 rows in turn.
__kernel void listed_triangles(__global const float *records, __constant float *view, __global uint *pixels,
    __global const uint *list, __global const int *listed, uint slots, int width, int height, int pass,
    int many DRAWN_TEXTURES)
{
    Target t = {pixels, width, height, pass IN_TARGET};
    int x = get_local_id(0) % 8, y = get_local_id(0) / 8 + 8 * get_group_id(1), rows = 8 * get_num_groups(1);
    for (int i = get_group_id(0); i < listed[many]; i += get_num_groups(0)) {
        uint slot = list[many ? slots - 1 - i : i];
        Outline o = make_outline(records + (size_t)slot * WORDS, view);
        for (int k = 1; k + 1 < o.n; k++) {
            Edges s = make_edges(&o, k, 0, 0, width, height);
            fill(&t, &o, &s, slot, view, x, 8, y, rows);
        }
    }
}

__kernel void shade(__global const float *records, __global const float *colors, __constant float *view,
    __global const uint *pixels, int width, int height, __global float *image, __global float *depth,
    __global float *alpha, __global int *faces, int all, float4 background TEXTURE_ARGUMENTS)
{
    int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    size_t pixel = (size_t)y * width + x;
    uint bits = pixels[2 * pixel + 1];
    float r = background.x, g = background.y, b = background.z, z = 0.0f;
    int face = NO_FACE;
    if (bits) {
        size_t slot = ~pixels[2 * pixel];
        __global const float *c = records + slot * WORDS;
        z = 1.0f / as_float(bits);
        face = INTEGERS(c)[FACE_WORD];
#if COLORS == TEXTURES
        Textures textures = TEXTURES_OF(records, colors);
        float light[4];
        surface(&textures, view, (int)slot, (float)x + 0.5f - view[OPTICAL], (float)y + 0.5f - view[OPTICAL + 1],
            light);
        r = encoded(light[0]);
        g = encoded(light[1]);
        b = encoded(light[2]);
#elif COLORS == FLOATS_OF_FACE
        r = c[9];
        g = c[10];
        b = c[11];
#else
        float px = (float)x + 0.5f - view[OPTICAL], py = (float)y + 0.5f - view[OPTICAL + 1];
        WEIGHTS(float, view, c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], px, py, w0, w1, w2)
        float exact[3];
        if (INTEGERS(c)[LONG_WORD] && wide_weights(c, view, px, py, exact)) {
            w0 = exact[0];
            w1 = exact[1];
            w2 = exact[2];
        }
#if COLORS == BYTES_OF_CORNERS
        int k0 = INTEGERS(c)[9], k1 = INTEGERS(c)[10], k2 = INTEGERS(c)[11];
#define BYTE(k, shift) (float)((k >> shift) & 255)
        w0 *= 1.0f / 255.0f;
        w1 *= 1.0f / 255.0f;
        w2 *= 1.0f / 255.0f;
        MIX(float, r, w0, BYTE(k0, 0), w1, BYTE(k1, 0), w2, BYTE(k2, 0))
        MIX(float, g, w0, BYTE(k0, 8), w1, BYTE(k1, 8), w2, BYTE(k2, 8))
        MIX(float, b, w0, BYTE(k0, 16), w1, BYTE(k1, 16), w2, BYTE(k2, 16))
#else
        __global const float *k = colors + slot * 9;
        MIX(float, r, w0, k[0], w1, k[3], w2, k[6])
        MIX(float, g, w0, k[1], w1, k[4], w2, k[7])
        MIX(float, b, w0, k[2], w1, k[5], w2, k[8])
#endif
        r = r < 1.0f ? r : 1.0f;
        g = g < 1.0f ? g : 1.0f;
        b = b < 1.0f ? b : 1.0f;
#endif
    }
    image[3 * pixel] = r;
    image[3 * pixel + 1] = g;
    image[3 * pixel + 2] = b;
    if (all) {
        depth[pixel] = z;
        alpha[pixel] = bits ? 1.0f : 0.0f;
        faces[pixel] = face;
    }
}
