// Colours of faces or vertices from spherical harmonics.
// The kernel file of each method includes this file.

#define MOST_REST 72 // number of floats of f_rest at degree 4

// max(0.5 + sum_k B_k(d) k_k, 0) with d = (p - c) / |p - c|, as all methods evaluate it
// (GaodeRender/triangle-splatting: submodules/diff-triangle-rasterization-2D/src/forward.cu, and copies).
void color_of(__constant View *view, __global const float *f_dc, __global const float *f_rest,
              const size_t *rows, vec3 towards, real *color)
{
    uint degree = view->degree;
#if LANES == 8
    real rest[MOST_REST];
    load_members(f_rest, rows, view->rest_stride, 3 * ((degree + 1) * (degree + 1) - 1), rest);
#else
    __global const float *rest = f_rest + rows[0] * view->rest_stride;
#endif
    vec3 sum = mul3(load3(f_dc, rows), (real)0.28209479177387814f);
    real x = towards.x - view->center[0], y = towards.y - view->center[1], z = towards.z - view->center[2];
    real length = root(x * x + y * y + z * z);
    x = x / length;
    y = y / length;
    z = z / length;
#define ADD(number, value)                                                                                   \
    do {                                                                                                     \
        real basis = value;                                                                                  \
        sum.x = sum.x + basis * rest[3 * number - 3];                                                    \
        sum.y = sum.y + basis * rest[3 * number - 2];                                                    \
        sum.z = sum.z + basis * rest[3 * number - 1];                                                    \
    } while (0)
    if (degree > 0) {
        ADD(1, -0.4886025119029199f * y);
        ADD(2, 0.4886025119029199f * z);
        ADD(3, -0.4886025119029199f * x);
    }
    real xx = x * x, yy = y * y, zz = z * z;
    real xy = x * y, yz = y * z, xz = x * z;
    if (degree > 1) {
        ADD(4, 1.0925484305920792f * xy);
        ADD(5, -1.0925484305920792f * yz);
        ADD(6, 0.31539156525252005f * (2.0f * zz - xx - yy));
        ADD(7, -1.0925484305920792f * xz);
        ADD(8, 0.5462742152960396f * (xx - yy));
    }
    if (degree > 2) {
        ADD(9, -0.5900435899266435f * y * (3.0f * xx - yy));
        ADD(10, 2.890611442640554f * xy * z);
        ADD(11, -0.4570457994644658f * y * (4.0f * zz - xx - yy));
        ADD(12, 0.3731763325901154f * z * (2.0f * zz - 3.0f * xx - 3.0f * yy));
        ADD(13, -0.4570457994644658f * x * (4.0f * zz - xx - yy));
        ADD(14, 1.445305721320277f * z * (xx - yy));
        ADD(15, -0.5900435899266435f * x * (xx - 3.0f * yy));
    }
    if (degree > 3) {
        ADD(16, 2.5033429417967046f * xy * (xx - yy));
        ADD(17, -1.7701307697799304f * yz * (3.0f * xx - yy));
        ADD(18, 0.9461746957575601f * xy * (7.0f * zz - 1.0f));
        ADD(19, -0.6690465435572892f * yz * (7.0f * zz - 3.0f));
        ADD(20, 0.10578554691520431f * (zz * (35.0f * zz - 30.0f) + 3.0f));
        ADD(21, -0.6690465435572892f * xz * (7.0f * zz - 3.0f));
        ADD(22, 0.47308734787878004f * (xx - yy) * (7.0f * zz - 1.0f));
        ADD(23, -1.7701307697799304f * xz * (xx - 3.0f * yy));
        ADD(24, 0.6258357354491761f * (xx * (xx - 3.0f * yy) - yy * (3.0f * xx - yy)));
    }
#undef ADD
    real zero = (real)0.0f; // the colour is 0 if the direction is NaN
    color[0] = greater(zero, sum.x + 0.5f);
    color[1] = greater(zero, sum.y + 0.5f);
    color[2] = greater(zero, sum.z + 0.5f);
}
