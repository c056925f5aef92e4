// The paper's n-camera least-squares triangulation (Hou, Kang & Qiao, Sensors 2025, 25(7), 2111, Eqs. 2-3).
//
// Each camera that sees a point gives two linear equations in X; all of them together are solved through the
// 3x3 normal equations, one lane per point. A camera that does not see a point (NaN) enters with weight 0.
#pragma once

#include "array.hpp"
#include "parallel.hpp"

namespace beltscape {

// A point is refused when |N| |N^-1| (Frobenius) of its normal matrix exceeds this: rays (nearly) parallel.
inline constexpr double kMaxCondition = 1e12;

// Upper triangle of the normal matrix N = AtA, and Atb.
template <class F>
struct Normal {
    F xx{}, xy{}, xz{}, yy{}, yz{}, zz{}, bx{}, by{}, bz{};

    BELTSCAPE_INLINE void add(F ax, F ay, F az, F b) {
        xx += ax * ax, xy += ax * ay, xz += ax * az, yy += ay * ay, yz += ay * az, zz += az * az;
        bx += ax * b, by += ay * b, bz += az * b;
    }
};

template <class F>
struct Point {
    F x, y, z, condition_squared;
};

template <class F>
BELTSCAPE_INLINE Point<F> solve(const Normal<F>& n) {
    const F cxx = n.yy * n.zz - n.yz * n.yz, cxy = n.xz * n.yz - n.xy * n.zz, cxz = n.xy * n.yz - n.xz * n.yy;
    const F cyy = n.xx * n.zz - n.xz * n.xz, cyz = n.xy * n.xz - n.xx * n.yz, czz = n.xx * n.yy - n.xy * n.xy;
    const F inverse_det = 1.0 / (n.xx * cxx + n.xy * cxy + n.xz * cxz);
    const F norm = n.xx * n.xx + n.yy * n.yy + n.zz * n.zz + 2.0 * (n.xy * n.xy + n.xz * n.xz + n.yz * n.yz);
    const F adjugate = cxx * cxx + cyy * cyy + czz * czz + 2.0 * (cxy * cxy + cxz * cxz + cyz * cyz);
    return {(cxx * n.bx + cxy * n.by + cxz * n.bz) * inverse_det,
            (cxy * n.bx + cyy * n.by + cyz * n.bz) * inverse_det,
            (cxz * n.bx + cyz * n.by + czz * n.bz) * inverse_det,
            norm * adjugate * inverse_det * inverse_det};
}

struct TriangulationInput {
    Array<const double, kAny, 3, 4> projections;
    Array<const double, kAny, kAny, 2> pixels;  // (cameras, points, 2) undistorted, NaN: not seen

    BELTSCAPE_INLINE size_t cameras() const { return pixels.shape[0]; }
    BELTSCAPE_INLINE size_t points() const { return pixels.shape[1]; }
    BELTSCAPE_INLINE void fields(const auto& read) {
        read("projections", projections), read("pixels", pixels);
    }
};

// Points first ... first + count - 1, at most as many as F has lanes; out (points, 3).
template <class F>
BELTSCAPE_INLINE void triangulate_lanes(const TriangulationInput& in, size_t first, int count, double* out) {
    Normal<F> normal;
    F views{};
    for (size_t c = 0; c < in.cameras(); ++c) {
        const double* m = in.projections.data + 12 * c;
        const double* pixel = in.pixels.data + 2 * (c * in.points() + first);
        F u{}, v{}, seen{};
        for (int i = 0; i < count; ++i) {
            if (!is_finite(pixel[2 * i]) || !is_finite(pixel[2 * i + 1])) continue;
            Lane<F>::set(u, i, pixel[2 * i]), Lane<F>::set(v, i, pixel[2 * i + 1]),
                Lane<F>::set(seen, i, 1.0);
        }
        views += seen;
        normal.add((u * m[8] - m[0]) * seen, (u * m[9] - m[1]) * seen, (u * m[10] - m[2]) * seen,
                   (m[3] - u * m[11]) * seen);
        normal.add((v * m[8] - m[4]) * seen, (v * m[9] - m[5]) * seen, (v * m[10] - m[6]) * seen,
                   (m[7] - v * m[11]) * seen);
    }
    const Point<F> point = solve(normal);
    for (int i = 0; i < count; ++i) {
        const bool good = Lane<F>::get(views, i) > 1.5 &&
                          Lane<F>::get(point.condition_squared, i) < kMaxCondition * kMaxCondition;
        double* target = out + 3 * (first + static_cast<size_t>(i));
        target[0] = good ? Lane<F>::get(point.x, i) : kNotANumber;
        target[1] = good ? Lane<F>::get(point.y, i) : kNotANumber;
        target[2] = good ? Lane<F>::get(point.z, i) : kNotANumber;
    }
}

#ifndef __CUDACC__
inline void triangulate(const TriangulationInput& in, std::size_t threads, Array<double, kAny, 3> out) {
    constexpr std::size_t kPointsPerJob = 4096;
    for_jobs((in.points() + kPointsPerJob - 1) / kPointsPerJob, threads, [&](std::size_t job) {
        const std::size_t end = std::min(in.points(), (job + 1) * kPointsPerJob);
        for (std::size_t first = job * kPointsPerJob; first < end; first += kDoubleLanes)
            triangulate_lanes<Doubles>(
                in, first, static_cast<int>(std::min<std::size_t>(kDoubleLanes, end - first)), out.data);
    });
}
#endif

}  // namespace beltscape
