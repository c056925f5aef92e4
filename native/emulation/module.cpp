// The module of the emulated GPU: every kernel of native/cuda, called by its name with a grid, a block, bytes
// of shared memory, a seed of the order (emulation.hpp) and a list of arguments: arrays for pointers,
// numbers.
#include "bind.hpp"
#include "cuda/kernels.cuh"

namespace beltscape {

// An argument as Python gives it: an array of just this type for a pointer, an int or a float. Nothing is
// converted, because a launch on a GPU does not, either.
template <class T>
struct Argument {
    static_assert(std::is_same_v<T, int> || std::is_same_v<T, float>);
    T value{};
    void read(nb::handle given, const Place& place) {
        constexpr bool is_float = std::is_same_v<T, float>;
        if (is_float ? !PyFloat_Check(given.ptr()) : !PyLong_Check(given.ptr()))
            refuse(place, is_float ? "a float" : "an int", given);
        beltscape::read(given, place, value);
    }
};
template <class T>
struct Argument<T*> {
    T* value = nullptr;
    void read(nb::handle given, const Place& place) {
        nb::ndarray<T, nb::c_contig, nb::device::cpu> array;
        if (!nb::try_cast(given, array, false))
            refuse(place, "a contiguous array of the kernel's type", given);
        value = array.data();
    }
};

dim3 size_of(const std::array<unsigned, 3>& size) { return {size[0], size[1], size[2]}; }

template <class... Parameter>
void bind_kernel(nb::module_& m, const char* name, void (*kernel)(Parameter...)) {
    const auto call = [name, kernel](nb::handle grid, nb::handle block, std::size_t shared_bytes,
                                     std::uint64_t seed, nb::handle given) {
        std::array<unsigned, 3> blocks{}, threads{};
        read(grid, {name, "grid"}, blocks), read(block, {name, "block"}, threads);
        const Place place{name, "arguments"};
        const nb::object items = items_of(given, place);
        if (count_of(items) != sizeof...(Parameter))
            refuse(place, std::to_string(sizeof...(Parameter)) + " arguments", given);
        std::tuple<Argument<Parameter>...> read_arguments;
        std::size_t i = 0;
        std::apply(
            [&](auto&... each) {
                ((each.read(item_of(items, i), {name, "arguments", static_cast<std::ptrdiff_t>(i)}), ++i),
                 ...);
            },
            read_arguments);
        const auto arguments = std::apply(
            [](const auto&... each) { return std::tuple<Parameter...>(each.value...); }, read_arguments);
        nb::gil_scoped_release release;
        emulation::launch(kernel, size_of(blocks), size_of(threads), shared_bytes, seed, arguments);
    };
    m.def(name, call, nb::arg("grid"), nb::arg("block"), nb::arg("shared_bytes"), nb::arg("seed"),
          nb::arg("arguments"));
}

}  // namespace beltscape

#define BELTSCAPE_KERNEL(name) beltscape::bind_kernel(m, #name, &beltscape::name)

NB_MODULE(_emulated, m) {
    BELTSCAPE_KERNEL(mean_level);
    BELTSCAPE_KERNEL(aligned_fields);
    BELTSCAPE_KERNEL(plane_places);
    BELTSCAPE_KERNEL(align_image);
    BELTSCAPE_KERNEL(sweep_planes);
    BELTSCAPE_KERNEL(aggregate_direction);
    BELTSCAPE_KERNEL(select_planes);
    BELTSCAPE_KERNEL(warp_view);
    BELTSCAPE_KERNEL(pad_core);
    BELTSCAPE_KERNEL(pad_view);
    BELTSCAPE_KERNEL(sum_columns);
    BELTSCAPE_KERNEL(normalise_core);
    BELTSCAPE_KERNEL(view_residuals);
    BELTSCAPE_KERNEL(sum_equations);
    BELTSCAPE_KERNEL(make_windows);
    BELTSCAPE_KERNEL(make_field);
    BELTSCAPE_KERNEL(fit_planes);
    BELTSCAPE_KERNEL(network_outputs);
    BELTSCAPE_KERNEL(network_of_programs);
    BELTSCAPE_KERNEL(message_rows);
    BELTSCAPE_KERNEL(message_outputs);
    BELTSCAPE_KERNEL(place_states);
    BELTSCAPE_KERNEL(add_changes);
    BELTSCAPE_KERNEL(filter_rows);
    BELTSCAPE_KERNEL(filter_columns);
    BELTSCAPE_KERNEL(gather_values);
    BELTSCAPE_KERNEL(fill_floats);
    BELTSCAPE_KERNEL(splat_corners);
    BELTSCAPE_KERNEL(spread_corners);
    BELTSCAPE_KERNEL(visible_pixels);
    BELTSCAPE_KERNEL(surface_candidates);
    BELTSCAPE_KERNEL(plane_consistency);
    BELTSCAPE_KERNEL(propagate_candidates);
    BELTSCAPE_KERNEL(propagate_direction);
    BELTSCAPE_KERNEL(pick_candidates);
    BELTSCAPE_KERNEL(evaluate_floats);
    BELTSCAPE_KERNEL(evaluate_bytes);
    BELTSCAPE_KERNEL(sum_window_rows);
    BELTSCAPE_KERNEL(average_window_columns);
    BELTSCAPE_KERNEL(window_row_extremes);
    BELTSCAPE_KERNEL(window_column_extremes);
    BELTSCAPE_KERNEL(median_of_window);
    BELTSCAPE_KERNEL(distance_along_row);
    BELTSCAPE_KERNEL(distance_to_mask);
    BELTSCAPE_KERNEL(average_areas);
    BELTSCAPE_KERNEL(average_blocks);
    BELTSCAPE_KERNEL(repeat_blocks);
    BELTSCAPE_KERNEL(subsample_plane);
    BELTSCAPE_KERNEL(interpolate_plane);
    BELTSCAPE_KERNEL(count_pixels);
    BELTSCAPE_KERNEL(sum_counts);
    BELTSCAPE_KERNEL(list_pixels);
    BELTSCAPE_KERNEL(repeat_first_pixel);
    BELTSCAPE_KERNEL(copy_floats);
    BELTSCAPE_KERNEL(put_pixels);
    BELTSCAPE_KERNEL(begin_addresses);
    BELTSCAPE_KERNEL(number_pixels);
    BELTSCAPE_KERNEL(pick_best);
    BELTSCAPE_KERNEL(sum_moment_rows);
    BELTSCAPE_KERNEL(average_moment_columns);
    BELTSCAPE_KERNEL(filter_plane);
    BELTSCAPE_KERNEL(find_quantile);
    BELTSCAPE_KERNEL(sum_stretches_of_bytes);
    BELTSCAPE_KERNEL(sum_stretches_of_words);
    BELTSCAPE_KERNEL(join_stretches);
    BELTSCAPE_KERNEL(levels_of_bytes);
    BELTSCAPE_KERNEL(levels_of_words);
    BELTSCAPE_KERNEL(blur_columns);
    BELTSCAPE_KERNEL(blur_rows);
    BELTSCAPE_KERNEL(sum_row_moments);
    BELTSCAPE_KERNEL(join_row_moments);
    BELTSCAPE_KERNEL(sum_phases);
    BELTSCAPE_KERNEL(join_phases);
}
