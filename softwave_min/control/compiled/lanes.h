/* Arithmetic on several numbers at once, for code that is emitted by control/lanes.py.
 *
 * The lanes are ARGUMENTS at the first of PLACES, then those at the next. A lane does what a
 * double would do: comparisons are 0 or 1, and a condition holds where it is not 0. GCC and
 * Clang turn the vectors into what the processor has.
 */
#include <math.h>

#define LANES (ARGUMENTS * PLACES)

typedef double lanes __attribute__((vector_size(8 * LANES)));
typedef long long masks __attribute__((vector_size(8 * LANES)));
/* In memory the lanes of a number lie side by side; nothing is said of their alignment. */
typedef double stored __attribute__((vector_size(8 * LANES), aligned(8), may_alias));

#define INLINE static inline __attribute__((always_inline))

INLINE lanes load(const double *from) {
#if PLACES == 1
    return *(const stored *)from;
#else
    lanes a;
    for (int i = 0; i < LANES; i++) a[i] = from[i % ARGUMENTS];
    return a;
#endif
}
INLINE void store(double *to, lanes a) {
#if PLACES == 1
    *(stored *)to = a;
#else
    for (int i = 0; i < ARGUMENTS; i++) to[i] = a[i];
#endif
}
INLINE lanes load_places(const double *from) {
    lanes a;
    for (int i = 0; i < LANES; i++) a[i] = from[i / ARGUMENTS];
    return a;
}
/* Over the places, for each argument; alike at all places. */
INLINE lanes total(lanes a) {
    double sum[ARGUMENTS] = {0};
    for (int i = 0; i < LANES; i++) sum[i % ARGUMENTS] += a[i];
    for (int i = 0; i < LANES; i++) a[i] = sum[i % ARGUMENTS];
    return a;
}
INLINE lanes all(double value) { return value - (lanes){0}; }
INLINE lanes where(masks mask, lanes a) { return (lanes)(mask & (masks)a); }
INLINE lanes either(masks mask, lanes a, lanes b) {
    return (lanes)((mask & (masks)a) | (~mask & (masks)b));
}

INLINE lanes less(lanes a, lanes b) { return where(a < b, all(1)); }
INLINE lanes less_equal(lanes a, lanes b) { return where(a <= b, all(1)); }
INLINE lanes negation(lanes a) { return where(a == all(0), all(1)); }
INLINE lanes if_true(lanes condition, lanes a) { return where(condition != all(0), a); }
INLINE lanes magnitude(lanes a) { return either(a < all(0), -a, a); }
INLINE lanes sign(lanes a) { return where(a > all(0), all(1)) - where(a < all(0), all(1)); }

INLINE lanes root(lanes a) {
    for (int i = 0; i < LANES; i++) a[i] = sqrt(a[i]);
    return a;
}

/* Added and taken away again, this leaves the nearest whole number. */
#define ROUNDING 0x1.8p52
/* pi/2 in two parts; whole multiples of the first, up to 2^20, are exact. */
#define QUARTER 0x1.921fb544p+0
#define REST 0x1.0b4611a626331p-34

#define MOST_QUARTERS 0x1p20

/* The angle less whole quarters of a turn, within pi/4 of 0, and their number modulo 4; NaN
 * where there are too many of them to be taken off exactly. */
INLINE lanes reduced(lanes angle, lanes *quarters) {
    lanes count = (angle * (2 / 3.14159265358979323846) + ROUNDING) - ROUNDING;
    *quarters = count - 4 * ((count / 4 - 0.375 + ROUNDING) - ROUNDING);
    lanes rest = (angle - count * QUARTER) - count * REST;
    return either(magnitude(count) <= all(MOST_QUARTERS), rest, all(NAN));
}

/* Taylor series; what is left out is below 1e-19 within pi/4 of 0. */
INLINE lanes near_sine(lanes r) {
    lanes z = r * r;
    lanes tail = -1 / 1307674368e3 + z * (1 / 355687428096e3);
    tail = -1 / 39916800. + z * (1 / 6227020800. + z * tail);
    tail = -1 / 5040. + z * (1 / 362880. + z * tail);
    return r + r * z * (-1 / 6. + z * (1 / 120. + z * tail));
}
INLINE lanes near_cosine(lanes r) {
    lanes z = r * r;
    lanes tail = 1 / 20922789888e3 + z * (-1 / 6402373705728e3);
    tail = 1 / 479001600. + z * (-1 / 87178291200. + z * tail);
    tail = 1 / 40320. + z * (-1 / 3628800. + z * tail);
    return 1 + z * (-1 / 2. + z * (1 / 24. + z * (-1 / 720. + z * tail)));
}

INLINE masks is_odd(lanes quarters) { return (quarters == all(1)) | (quarters == all(3)); }
INLINE lanes sine(lanes angle) {
    lanes quarters, r = reduced(angle, &quarters);
    lanes value = either(is_odd(quarters), near_cosine(r), near_sine(r));
    return either(quarters >= all(2), -value, value);
}
INLINE lanes cosine(lanes angle) {
    lanes quarters, r = reduced(angle, &quarters);
    lanes value = either(is_odd(quarters), near_sine(r), near_cosine(r));
    return either((quarters == all(1)) | (quarters == all(2)), -value, value);
}
