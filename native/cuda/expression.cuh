// Element-wise expressions on a GPU: a thread takes an element and runs a program on a stack of numbers, so
// that a chain of NumPy's functions is one launch. kernels/expressions.py writes the programs.
#pragma once

#include "cuda/device.hpp"
#ifndef __CUDACC__
#include <cmath>
#endif

namespace beltscape {

// In the order of `OPERATIONS` in kernels/expressions.py.
enum Operation : int {
    kLoad,
    kConstant,
    kAdd,
    kSubtract,
    kMultiply,
    kDivide,
    kMaximum,
    kMinimum,
    kFmax,
    kFmin,
    kAbsolute,
    kNegative,
    kSqrt,
    kSquare,
    kLog,
    kLog1p,
    kExp,
    kHypot,
    kCopysign,
    kPower,
    kLess,
    kLessEqual,
    kGreater,
    kGreaterEqual,
    kEqual,
    kNotEqual,
    kAnd,
    kOr,
    kNot,
    kIsFinite,
    kIsNan,
    kWhere,
    kToByte,
};

inline constexpr int kMostStack = 32;

// An input's elements: floats or bytes, and the steps from row to row and from column to column (0: the same
// element in all).
struct ExpressionInput {
    int is_byte, row_step, column_step;
};

__device__ inline float truth(bool is_true) { return is_true ? 1.0f : 0.0f; }

__device__ inline float apply_unary(int operation, float a) {
    switch (operation) {
        case kAbsolute:
            return absolute(a);
        case kNegative:
            return -a;
        case kSqrt:
            return square_root(a);
        case kSquare:
            return a * a;
        case kLog:
            return logf(a);
        case kLog1p:
            return log1pf(a);
        case kExp:
            return expf(a);
        case kNot:
            return truth(a == 0);
        case kIsFinite:
            return truth(a - a == 0);
        case kIsNan:
            return truth(a != a);
        default:
            return to_float(static_cast<int>(a) & 255);  // kToByte
    }
}

// Maximum and minimum are NaN where one of both is, as NumPy's are.
__device__ inline float apply_binary(int operation, float a, float b) {
    switch (operation) {
        case kAdd:
            return a + b;
        case kSubtract:
            return a - b;
        case kMultiply:
            return a * b;
        case kDivide:
            return a / b;
        case kMaximum:
            return a >= b || a != a ? a : b;
        case kMinimum:
            return a <= b || a != a ? a : b;
        case kFmax:
            return a >= b || b != b ? a : b;
        case kFmin:
            return a <= b || b != b ? a : b;
        case kHypot:
            return hypotf(a, b);
        case kCopysign:
            return copysignf(a, b);
        case kPower:
            return powf(a, b);
        case kLess:
            return truth(a < b);
        case kLessEqual:
            return truth(a <= b);
        case kGreater:
            return truth(a > b);
        case kGreaterEqual:
            return truth(a >= b);
        case kEqual:
            return truth(a == b);
        case kNotEqual:
            return truth(a != b);
        case kAnd:
            return truth(a != 0 && b != 0);
        default:
            return truth(a != 0 || b != 0);  // kOr
    }
}

__device__ inline bool is_unary(int operation) {
    return (operation >= kAbsolute && operation <= kExp) || (operation >= kNot && operation <= kIsNan) ||
           operation == kToByte;
}

__device__ inline float load_input(const unsigned long long* addresses, const ExpressionInput* inputs, int i,
                                   int x, int y) {
    const ExpressionInput input = inputs[i];
    const size_t at = static_cast<size_t>(y) * input.row_step + static_cast<size_t>(x) * input.column_step;
    return input.is_byte ? to_float(array_at<unsigned char>(addresses, i)[at])
                         : array_at<float>(addresses, i)[at];
}

// program (length, 2): an operation and the number of its input or constant; inputs (n, 3) as above.
__device__ inline float evaluate_element(const int* program, int length, const unsigned long long* addresses,
                                         const int* inputs, const float* constants, int x, int y) {
    float stack[kMostStack];
    int top = 0;
    for (int i = 0; i < length; ++i) {
        const int operation = program[2 * i], number = program[2 * i + 1];
        if (operation == kLoad) {
            stack[top++] =
                load_input(addresses, reinterpret_cast<const ExpressionInput*>(inputs), number, x, y);
        } else if (operation == kConstant) {
            stack[top++] = constants[number];
        } else if (operation == kWhere) {
            top -= 2;
            stack[top - 1] = stack[top - 1] != 0 ? stack[top] : stack[top + 1];
        } else if (is_unary(operation)) {
            stack[top - 1] = apply_unary(operation, stack[top - 1]);
        } else {
            --top;
            stack[top - 1] = apply_binary(operation, stack[top - 1], stack[top]);
        }
    }
    return stack[0];
}

// A thread takes an element of out (height, width).
extern "C" __global__ void evaluate_floats(const int* program, int length,
                                           const unsigned long long* addresses, const int* inputs,
                                           const float* constants, int width, int height, float* out) {
    const int x = grid_x();
    if (x >= width) return;
    for (int y = grid_y(); y < height; y += static_cast<int>(gridDim.y * blockDim.y))
        out[static_cast<size_t>(y) * width + x] =
            evaluate_element(program, length, addresses, inputs, constants, x, y);
}

extern "C" __global__ void evaluate_bytes(const int* program, int length, const unsigned long long* addresses,
                                          const int* inputs, const float* constants, int width, int height,
                                          unsigned char* out) {
    const int x = grid_x();
    if (x >= width) return;
    for (int y = grid_y(); y < height; y += static_cast<int>(gridDim.y * blockDim.y))
        out[static_cast<size_t>(y) * width + x] = static_cast<unsigned char>(
            static_cast<int>(evaluate_element(program, length, addresses, inputs, constants, x, y)));
}

}  // namespace beltscape
