// Vectors of whole numbers, the cells of a pixel's planes. For the CPU alone; exact, so that every width
// gives the same result.
#pragma once

#if __has_include(<sys/mman.h>)
#include <sys/mman.h>
#endif

#include <cstdint>
#include <memory>
#include <new>

#include "pairs.hpp"

namespace beltscape {

// At most 32 bytes: half of the loads of neighbouring planes cross no cache line then, as each of 64 bytes
// does. On an EPYC with AVX-512 an aggregation takes 0.7 to 0.9 of its time with 64 bytes.
inline constexpr int kCellBytes = kVectorBytes < 32 ? kVectorBytes : 32;

template <class Cell, int bytes = kCellBytes>
struct CellVector {
    typedef Cell Type __attribute__((vector_size(bytes)));
    static constexpr int count = bytes / static_cast<int>(sizeof(Cell));
};
template <class Cell>
using Cells = typename CellVector<Cell>::Type;
template <class Cell>
inline constexpr int kCells = CellVector<Cell>::count;

template <class V>
inline V least_cells(V a, V b) {
    return a < b ? a : b;
}

template <class V, class T>
inline V load_cells(const T* from) {
    V cells;
    __builtin_memcpy(&cells, from, sizeof cells);
    return cells;
}

template <class V, class T>
inline void store_cells(T* to, V cells) {
    __builtin_memcpy(to, &cells, sizeof cells);
}

template <int shift, int... lane, class V>
inline auto shifted(V cells, Lanes<lane...>) {
    return __builtin_shufflevector(cells, cells, (lane + shift) % (sizeof(V) / sizeof(cells[0]))...);
}

// The least of the cells of 16 bytes, of which `left` remain to be compared.
template <class Cell, int left, class V>
inline Cell least_within(V cells) {
    if constexpr (left == 1)
        return cells[0];
    else
        return least_within<Cell, left / 2>(
            least_cells(cells, shifted<left / 2>(cells, LanesTo<16 / sizeof(Cell)>())));
}

template <class Cell, int bytes = kCellBytes, class V>
inline Cell least_cell(V cells) {
    if constexpr (bytes == 16) {
        return least_within<Cell, 16 / sizeof(Cell)>(cells);
    } else {
        constexpr int half = bytes / 2 / sizeof(Cell);
        return least_cell<Cell, bytes / 2>(
            least_cells(shifted<0>(cells, LanesTo<half>()), shifted<half>(cells, LanesTo<half>())));
    }
}

// 16 bytes of 16 rows.
inline constexpr int kTile = 16;
using TileRow = CellVector<std::uint8_t, kTile>::Type;

template <int... lane>
inline void interleave(TileRow low, TileRow high, TileRow* out, Lanes<lane...>) {
    out[0] = __builtin_shufflevector(low, high, (lane / 2 + lane % 2 * kTile)...);
    out[1] = __builtin_shufflevector(low, high, (kTile / 2 + lane / 2 + lane % 2 * kTile)...);
}

// Exchanges rows and columns: each step interleaves the first half of the rows with the second one.
inline void transpose_tile(TileRow (&rows)[kTile]) {
#pragma GCC unroll 4
    for (int step = 1; step < kTile; step *= 2) {
        TileRow next[kTile];
#pragma GCC unroll 8
        for (int i = 0; i < kTile / 2; ++i)
            interleave(rows[i], rows[i + kTile / 2], next + 2 * i, LanesTo<kTile>());
#pragma GCC unroll 16
        for (int i = 0; i < kTile; ++i) rows[i] = next[i];
    }
}

// Memory of `count` cells aligned to a cache line; large buffers are on huge pages, which are allocated many
// times faster.
template <class Cell>
class CellBuffer {
public:
    explicit CellBuffer(std::size_t count) {
        const std::size_t page = count * sizeof(Cell) < kLargePage ? 64 : kLargePage;
        const std::size_t bytes = (count * sizeof(Cell) + page) / page * page;
        void* const memory = ::operator new(bytes, std::align_val_t{page});
#ifdef MADV_HUGEPAGE
        if (page == kLargePage) madvise(memory, bytes, MADV_HUGEPAGE);  // a wish: refusing it is no fault
#endif
        cells_ = {static_cast<Cell*>(memory), Free{page}};
    }
    Cell* data() const { return cells_.get(); }

private:
    static constexpr std::size_t kLargePage = 1 << 21;
    struct Free {
        std::size_t page = 64;
        void operator()(Cell* cells) const { ::operator delete(cells, std::align_val_t{page}); }
    };
    std::unique_ptr<Cell, Free> cells_;
};

}  // namespace beltscape
