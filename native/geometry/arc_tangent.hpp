// The arc tangents of numbers: the lanes' function, for its test.
#pragma once

#include "array.hpp"

namespace beltscape {

struct ArcTangentsInput {
    List<const float> tangents;

    void fields(const auto& read) { read("tangents", tangents); }
};

inline void arc_tangents(const ArcTangentsInput& in, std::size_t, List<float> angles) {
    const int count = static_cast<int>(in.tangents.shape[0]);
    for (int i = 0; i < count; i += Lane<Floats>::count) {
        const Floats lanes = load_first<Floats>(in.tangents.data + i, count - i);
        store_first(angles.data + i, arc_tangent(lanes), count - i);
    }
}

}  // namespace beltscape
