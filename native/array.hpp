// Arrays as the kernels receive them: contiguous elements and their number along each axis. A kernel's input
// is a struct of arrays and numbers whose `fields` lists them by the names of the Python record.
#pragma once

#include "view.hpp"

namespace beltscape {

inline constexpr long kAny = -1;  // an axis of any length

template <class T, long... lengths>
struct Array {
    T* data;
    size_t shape[sizeof...(lengths)];

    BELTSCAPE_INLINE T& operator[](size_t i) const { return data[i]; }
    BELTSCAPE_INLINE T* row(int y) const { return data + static_cast<size_t>(y) * shape[1]; }
    BELTSCAPE_INLINE int height() const { return static_cast<int>(shape[0]); }
    BELTSCAPE_INLINE int width() const { return static_cast<int>(shape[1]); }
};

template <class T>
using List = Array<T, kAny>;
template <class T>
using Grid = Array<T, kAny, kAny>;
template <class T>
using Stack = Array<T, kAny, kAny, kAny>;
using PackedView = Array<const float, kViewFloats>;  // a View
using PackedViews = Array<const float, kAny, kViewFloats>;

#ifndef __CUDACC__
inline View view_of(const float* packed) {
    View view;
    __builtin_memcpy(&view, packed, sizeof view);
    return view;
}
#endif

}  // namespace beltscape
