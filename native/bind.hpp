// The binding of every kernel. A kernel is a function (const Input& in, std::size_t threads, results ...).
// Its Input lists its fields with their names, by which they are read from the Python record (a NamedTuple)
// that the kernel's family has checked and filled:
//
//   struct WarpInput {
//       Grid<const float> s;
//       float tolerance;
//       void fields(const auto& read) { read("s", s), read("tolerance", tolerance); }
//   };
//   void warp(const WarpInput& in, std::size_t threads, Grid<float> value, Grid<float> slope);
//   bind(m, "warp", &warp);
//
// A record that lacks a field, has another one besides, or holds an array of another type, number of axes or
// memory layout is refused with a TypeError. Nothing is converted or copied but Python's numbers.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <array>
#include <optional>
#include <string>
#include <tuple>
#include <type_traits>
#include <vector>

#include "array.hpp"

namespace beltscape {

namespace nb = nanobind;

// What is read, for errors: the kernel, the field, and the number in a list (-1: the field itself).
struct Place {
    const char *kernel, *field;
    std::ptrdiff_t number = -1;
};

[[noreturn]] inline void refuse(const Place& place, const std::string& expected, nb::handle value) {
    std::string text = std::string(place.kernel) + ": " + place.field;
    if (place.number >= 0) text += "[" + std::to_string(place.number) + "]";
    nb::object what = nb::borrow(value.type().attr("__name__"));
    if (nb::hasattr(value, "dtype")) what = nb::str("{} {}").format(value.attr("dtype"), value.attr("shape"));
    throw nb::type_error((text + " must be " + expected + ", not " + nb::str(what).c_str()).c_str());
}

template <class Input>
concept Record = requires(Input& input) { input.fields([](const char*, auto&) {}); };

template <class T>
    requires std::is_arithmetic_v<T>
void read(nb::handle value, const Place& place, T& to) {
    if (!nb::try_cast<T>(value, to)) refuse(place, std::is_integral_v<T> ? "an integer" : "a number", value);
}

template <class T, long... lengths>
void read(nb::handle value, const Place& place, Array<T, lengths...>& to) {
    using Given = nb::ndarray<T, nb::shape<lengths...>, nb::c_contig, nb::device::cpu>;
    Given given;
    if (!nb::try_cast<Given>(value, given, false))
        refuse(place, std::string("a contiguous ") + nb::detail::make_caster<Given>::Name.text, value);
    to.data = given.data();
    for (std::size_t axis = 0; axis < sizeof...(lengths); ++axis) to.shape[axis] = given.shape(axis);
}

// The items of a list or a tuple.
inline nb::object items_of(nb::handle value, const Place& place) {
    PyObject* const items = PySequence_Fast(value.ptr(), "");
    if (!items) PyErr_Clear(), refuse(place, "a list", value);
    return nb::steal(items);
}
inline std::size_t count_of(const nb::object& items) {
    return static_cast<std::size_t>(PySequence_Size(items.ptr()));
}
inline nb::handle item_of(const nb::object& items, std::size_t i) {
    const auto at = static_cast<Py_ssize_t>(i);  // PySequence_Fast gives one or the other
    return PyList_Check(items.ptr()) ? PyList_GetItem(items.ptr(), at) : PyTuple_GetItem(items.ptr(), at);
}

template <class Items>
void read_items(const nb::object& items, const Place& place, Items& to) {
    for (std::size_t i = 0; i < to.size(); ++i)
        read(item_of(items, i), {place.kernel, place.field, static_cast<std::ptrdiff_t>(i)}, to[i]);
}

template <class Item>
void read(nb::handle value, const Place& place, std::vector<Item>& to) {
    const nb::object items = items_of(value, place);
    to.resize(count_of(items));
    read_items(items, place, to);
}

template <class Item, std::size_t count>
void read(nb::handle value, const Place& place, std::array<Item, count>& to) {
    const nb::object items = items_of(value, place);
    if (count_of(items) != count) refuse(place, std::to_string(count) + " arrays", value);
    read_items(items, place, to);
}

template <class T>
void read(nb::handle value, const Place& place, std::optional<T>& to) {
    if (!value.is_none()) read(value, place, to.emplace());
}

template <Record Input>
void read(nb::handle record, const Place& place, Input& input) {
    if (!nb::isinstance<nb::tuple>(record)) refuse(place, "a NamedTuple", record);
    std::size_t count = 0;
    input.fields([&](const char* name, auto& field) {
        PyObject* const value = PyObject_GetAttrString(record.ptr(), name);
        if (!value) PyErr_Clear(), refuse(place, std::string("a record with the field ") + name, record);
        read(nb::steal(value), {place.kernel, name}, field);  // the record holds it as well
        ++count;
    });
    if (nb::len(record) != count)
        refuse(place, "a record of the " + std::to_string(count) + " fields in the kernel's header", record);
}

// Results in a list of any length are one argument of the kernel, others one each.
template <class... Out>
void read_results(nb::handle results, const Place& place, std::tuple<Out...>& out) {
    const nb::object items = items_of(results, place);
    if (count_of(items) != sizeof...(Out)) refuse(place, std::to_string(sizeof...(Out)) + " arrays", results);
    std::size_t i = 0;
    std::apply(
        [&](Out&... each) {
            ((read(item_of(items, i), {place.kernel, place.field, static_cast<std::ptrdiff_t>(i)}, each),
              ++i),
             ...);
        },
        out);
}
template <class Item>
void read_results(nb::handle results, const Place& place, std::tuple<std::vector<Item>>& out) {
    read(results, place, std::get<0>(out));
}

template <class Input, class... Out>
void bind(nb::module_& m, const char* name, void (*kernel)(const Input&, std::size_t, Out...)) {
    const auto call = [name, kernel](nb::handle record, nb::handle results, std::size_t threads) {
        Input input{};
        std::tuple<std::remove_cvref_t<Out>...> out;
        read(record, {name, "the input"}, input);
        read_results(results, {name, "results"}, out);
        nb::gil_scoped_release release;
        std::apply([&](const auto&... each) { kernel(input, threads, each...); }, out);
    };
    m.def(name, call, nb::arg("record"), nb::arg("results"), nb::arg("threads"));
}

// The groups of kernels; module.cpp calls them.
void bind_sweep(nb::module_& m);
void bind_selection(nb::module_& m);
void bind_least_squares(nb::module_& m);
void bind_images(nb::module_& m);
void bind_geometry(nb::module_& m);
void bind_networks(nb::module_& m);
void bind_holes(nb::module_& m);
void bind_photometry(nb::module_& m);

}  // namespace beltscape
