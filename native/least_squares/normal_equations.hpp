// The normal equations of one row of pixels for a change of s: from every view its information about s and
// its pull; the least-squares change of one pixel alone is pull / information.
//
// With I the core and J a view's warp, both normalised in a window to
//   n = (value - mean) / sqrt(variance + floor),
// and r = n_I - n_J, a view's part is  w (dn_J/ds)²  and  w (dn_J/ds) r. Its weight is Cauchy's,
//   w = 1 / (var(r) (1 + (q / gate)²)),
// with q the mean of r² / var(r) in a smaller window. The windows leave out pixels where the core is NaN;
// beyond the image its outermost pixels are repeated. Rows are those of box_sums.hpp.
#pragma once

#include "least_squares/box_sums.hpp"
#include "simd.hpp"

namespace beltscape {

struct NormalSettings {
    int window, residual_window;  // radii
    float floor, noise_variance, model_variance, gate;

    BELTSCAPE_INLINE void fields(const auto& read) {
        read("window", window), read("residual_window", residual_window), read("floor", floor);
        read("noise_variance", noise_variance), read("model_variance", model_variance), read("gate", gate);
    }
};

// The core without NaN: 0 where `there` is 0, else 1.
template <class F>
BELTSCAPE_INLINE void core_row(const float* core, int width, float* grey, float* there) {
    const F zero{};
    for (int x = 0; x < width; x += Lane<F>::count) {
        const F value = load_first<F>(core + x, width - x);
        const MaskOf<F> missing = not_a_number(value);
        store(grey + x, select(missing, zero, value));
        store(there + x, select(missing, zero, zero + 1.0f));
    }
}

// Completes a view's warp in place: where it or the core is NaN, the value becomes the core's and the slope
// NaN.
template <class F>
BELTSCAPE_INLINE void complete_row(const float* grey, const float* there, int width, float* value,
                                   float* slope) {
    const F nothing = broadcast<F>(kNotANumber);
    for (int x = 0; x < width; x += Lane<F>::count) {
        const F warped = load<F>(value + x);
        const MaskOf<F> outside = not_a_number(warped) | (load<F>(there + x) == 0.0f);
        store(value + x, select(outside, load<F>(grey + x), warped));
        store(slope + x, select(outside, nothing, load<F>(slope + x)));
    }
}

// part: one over the number of a window's valid pixels, from the sums of its columns; 0 where there are none.
template <class F>
BELTSCAPE_INLINE void part_row(const float* columns, int radius, int width, float* part) {
    const F zero{};
    for (int x = 0; x < width; x += Lane<F>::count) {
        const F count = across<F>(columns + x, radius);
        store(part + x, select(count > 0.0f, 1.0f / count, zero));
    }
}

template <class F>
struct Normalised {
    F value, scale;  // (grey - mean) scale
};

// `sums` and `squares` of columns, at the pixel.
template <class F>
BELTSCAPE_INLINE Normalised<F> normalised(const NormalSettings& settings, const float* grey,
                                          const float* sums, const float* squares, F part) {
    const F mean = across<F>(sums, settings.window) * part;
    const F variance = multiply_add(-mean, mean, across<F>(squares, settings.window) * part);
    const F scale = 1.0f / square_root(greater(variance, F{}) + settings.floor);
    return {(load<F>(grey) - mean) * scale, scale};
}

// The core's share of a row's residuals.
struct CoreNormals {
    float *value, *scale, *part;
    const float* there;
};

template <class F>
BELTSCAPE_INLINE void core_normals_row(const NormalSettings& settings, const float* grey, const float* sums,
                                       const float* squares, int width, const CoreNormals& out) {
    for (int x = 0; x < width; x += Lane<F>::count) {
        const Normalised<F> core =
            normalised(settings, grey + x, sums + x, squares + x, load<F>(out.part + x));
        store(out.value + x, core.value), store(out.scale + x, core.scale);
    }
}

// A view's residuals r, their slopes dn_J/ds (NaN where it does not count), 1 / var(r), and misfits r² /
// var(r).
struct Residuals {
    float *value, *slope, *weight, *misfit;
};

template <class F>
BELTSCAPE_INLINE void residuals_row(const NormalSettings& settings, const CoreNormals& core,
                                    const float* grey, const float* slope, const float* sums,
                                    const float* squares, int width, const Residuals& out) {
    for (int x = 0; x < width; x += Lane<F>::count) {
        const Normalised<F> view =
            normalised(settings, grey + x, sums + x, squares + x, load<F>(core.part + x));
        const F core_scale = load<F>(core.scale + x), r = load<F>(core.value + x) - view.value;
        const F variance = multiply_add(multiply_add(view.scale, view.scale, core_scale * core_scale),
                                        settings.noise_variance, settings.model_variance);
        const F weight = 1.0f / variance;
        store(out.value + x, r), store(out.weight + x, weight);
        store(out.slope + x, load<F>(slope + x) * view.scale);
        store(out.misfit + x, r * r * weight * load<F>(core.there + x));
    }
}

// Sums over all views; here a view's `misfit` holds the sums of columns.
struct Equations {
    float *information, *pull;
    unsigned char* used;
};

template <class F>
BELTSCAPE_INLINE void equations_row(const NormalSettings& settings, const Residuals* views, int count,
                                    const float* part, int width, const Equations& out) {
    const F zero{};
    const float by_gate = 1.0f / settings.gate;
    for (int x = 0; x < width; x += Lane<F>::count) {
        F information{}, pull{};
        IntOf<F> used{};
        for (int k = 0; k < count; ++k) {
            const Residuals& view = views[k];
            const F slope = load<F>(view.slope + x), near = load<F>(part + x);
            const MaskOf<F> inside = negate(not_a_number(slope));
            const F q = across<F>(view.misfit + x, settings.residual_window) * near * by_gate;
            const F weighted_slope = select(
                inside, slope * load<F>(view.weight + x) / multiply_add(q, q, broadcast<F>(1.0f)), zero);
            information = multiply_add(weighted_slope, select(inside, slope, zero), information);
            pull = multiply_add(weighted_slope, load<F>(view.value + x), pull);
            used += select(inside & (q < 1.0f), broadcast<IntOf<F>>(1), IntOf<F>{});
        }
        store_first(out.information + x, information, width - x);
        store_first(out.pull + x, pull, width - x);
        store_first(out.used + x, used, width - x);
    }
}

}  // namespace beltscape
