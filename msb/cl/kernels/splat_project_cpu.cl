// Projection in CPU style.
// One work-item takes `chunk` consecutive faces in groups, and skips groups whose sphere is out of view.
// Faces that may be kept are queued and projected eight at a time; most views keep few faces.
// Listed faces are written consecutively from the first position of the chunk.
// The listed faces are then coloured in groups of eight. Tile lists refer to faces by these positions, not by
// rows or face numbers.

#define QUEUE 64 // a power of two
#define AHEAD 40 // faces to prefetch

typedef struct {
    __global Face *faces;
    __global uint *keys;
    __global Tiles *tiles;
    __global uchar *visible;
} Found;

uint first_bits(size_t count) { return count < LANES ? (1u << count) - 1u : 0xffu; }

// Projects the first `count` of eight faces; returns the next free position.
size_t project_eight(const size_t *rows, size_t count, const Source *source, __constant View *view,
                     const Found *out, size_t place)
{
    FaceLanes projected;
    real depth, *words = projected.words;
    Box t;
    mask kept, seen = project_seen(rows, source, view, &projected.faces, &t, &depth, &kept);
    uint meant = first_bits(count), kept_bits = bits8(kept) & meant, seen_bits = bits8(seen) & meant;
    for (; kept_bits; kept_bits &= kept_bits - 1)
        out->visible[rows[LOWEST_BIT(kept_bits)]] = 1;
    if (!seen_bits)
        return place;
    for (uint k = 0; k < LANES; k++)
        ((int *)&projected.faces.number)[k] = (int)rows[k];
    // Transpose words w to w + 7 of eight faces, so that each face has its eight words together.
    for (uint w = 0; w < FACE_WORDS; w += LANES)
        TRANSPOSE(words[w], words[w + 1], words[w + 2], words[w + 3], words[w + 4], words[w + 5],
                  words[w + 6], words[w + 7]);
    for (; seen_bits; seen_bits &= seen_bits - 1, place++) {
        uint k = LOWEST_BIT(seen_bits);
        __global real *face = (__global real *)(out->faces + place);
        for (uint w = 0; w < FACE_WORDS; w += LANES)
            face[w / LANES] = words[w + k];
        out->keys[place] = PICK(depth, k);
        out->tiles[place] = (Tiles)(PICK(t.x0, k), PICK(t.y0, k), PICK(t.x1, k), PICK(t.y1, k));
        prefetch_colors(rows[k], source, view);
    }
    return place;
}

// Colours the first `count` of eight faces, and replaces row indices by face numbers.
void color_eight(__global Face *faces, size_t count, __global const uint *numbers, const Source *source,
                 __constant View *view)
{
    size_t rows[LANES];
    real color[COLORS];
    for (uint k = 0; k < LANES; k++) {
        __global const Face *face = faces + (k < count ? k : 0);
        rows[k] = face->number;
#if !VERTEX_COLORS
        for (uint c = 0; c < COLORS; c++)
            ((float *)&color[c])[k] = face->color[c];
#endif
    }
    color_faces(rows, source, view, color);
    for (uint k = 0; k < count && k < LANES; k++) {
        faces[k].number = (int)numbers[rows[k]];
        for (uint c = 0; c < COLORS; c++)
            faces[k].color[c] = PICK_F(color[c], k);
    }
}

// `listed` is the number of listed faces of each work-item.
__kernel void project(__constant View *view, __global const float *groups, __global const float *bounds,
                      __global const uint *numbers, __global const float *positions,
                      __global const uint *indices, __global const float *coverage,
                      __global const float *f_dc, __global const float *f_rest, __global Face *faces,
                      __global uint *keys, __global Tiles *tiles, __global uint *listed,
                      __global uchar *visible, uint count, uint chunk, uint group_stride, uint stride)
{
    __constant Limits *limits = &view->limits;
    float depth_growth = limits->depth_growth, group_growth = depth_growth > 1.0f ? depth_growth : 1.0f;
    size_t begin = get_global_id(0) * chunk, end = begin + chunk < count ? begin + chunk : count;
    Source source = {positions, indices, coverage, f_dc, f_rest};
    Found out = {faces, keys, tiles, visible};
    size_t queue[QUEUE], head = 0, tail = 0, place = begin, colored = begin;
    for (size_t i = begin; i < end; i++)
        visible[i] = 0;
    for (size_t block = begin; block < end; block += LANES * FACE_GROUP) {
        uint near = bits8(may_be_kept(view, groups, group_stride, block / FACE_GROUP, group_growth));
        for (near &= first_bits((end - block + FACE_GROUP - 1) / FACE_GROUP); near; near &= near - 1) {
            size_t first = block + FACE_GROUP * LOWEST_BIT(near), last = first + FACE_GROUP < end ? first + FACE_GROUP : end;
            for (size_t i = first; i < last; i += LANES) {
                uint kept = bits8(may_be_kept(view, bounds, stride, i, depth_growth)) & first_bits(last - i);
                for (; kept; kept &= kept - 1) {
                    size_t row = i + LOWEST_BIT(kept);
                    prefetch_face(row, &source);
                    queue[tail++ % QUEUE] = row;
                }
                if (tail - head < AHEAD + LANES)
                    continue;
                place = project_eight(queue + head % QUEUE, LANES, &source, view, &out, place);
                head += LANES;
                if (place - colored < AHEAD + LANES)
                    continue;
                color_eight(faces + colored, LANES, numbers, &source, view);
                colored += LANES;
            }
        }
    }
    for (; head < tail; head += LANES) {
        size_t *rows = queue + head % QUEUE;
        for (size_t k = tail - head; k < LANES; k++)
            rows[k] = rows[0];
        place = project_eight(rows, tail - head, &source, view, &out, place);
    }
    for (; colored < place; colored += LANES)
        color_eight(faces + colored, place - colored, numbers, &source, view);
    listed[get_global_id(0)] = (uint)(place - begin);
}
