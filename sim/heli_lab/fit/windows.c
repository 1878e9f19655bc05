/* Free runs over many windows, with exact derivatives: the loop around the functions of a model.
   `compiled.py` puts these macros before it:

   NX, NZ, NS         numbers of states, of derivatives (by the states and the free parameters) and
                      of free parameters that change the voltages
   SIZE_*             sizes of the functions' results
   ANGLES_ARE_STATES  whether the measured angles are the first three states
   HAS_RESET          whether effects reset states after a step
   CHAIN_*            the chain rule, out = fx s + fp + fu du, over what is not structurally zero

   s are the sensitivities of the states, du the derivatives of the voltages. */
#include <math.h>
#include <string.h>

/* One window is in each lane of a vector: windows are independent, the operations of one window are
   not. */
#define LANES 4
typedef double Lanes __attribute__((vector_size(LANES * sizeof(double))));
/* A comparison of vectors: in each lane all bits are set, or none. */
typedef long long Mask __attribute__((vector_size(sizeof(Lanes))));

/* Compiled for wider vectors too where the loader can choose. Nothing is contracted: every machine
   finds the same numbers. */
#define INLINE static inline __attribute__((always_inline))
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__linux__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#else
#define WIDE
#endif

#define MAX(a, b) ((a) > (b) ? (a) : (b))

/* The same number in all lanes. A macro: without AVX a vector is not returned in a register. */
#define all(value) ((Lanes){(value), (value), (value), (value)})

/* The functions of the model end here. */

INLINE void chain_rates(const Lanes* fx, const Lanes* fp, const Lanes* fu, Lanes (*du)[2],
                        Lanes (*s)[NZ], Lanes (*out)[NZ]) {
  CHAIN_RATES;
}

INLINE void chain_angles(const Lanes* fx, const Lanes* fp, const Lanes* fu, Lanes (*du)[2],
                         Lanes (*s)[NZ], Lanes (*out)[NZ]) {
  CHAIN_ANGLES;
}

/* Voltages of a step of each window, with their derivatives, which are zero without a parameter. */
typedef struct {
  Lanes mean[2], change[2], mean_by[NS][2], change_by[NS][2];
} Row;

/* Voltages u at the share c, 0 to 1, of a step, with their derivatives. */
INLINE void input(const Row* row, double c, Lanes* u, Lanes (*du)[2]) {
  for (int i = 0; i < 2; ++i) {
    u[i] = row->mean[i] + (c - 0.5) * row->change[i];
    for (int j = 0; j < NS; ++j) {
      du[j][i] = row->mean_by[j][i] + (c - 0.5) * row->change_by[j][i];
    }
  }
}

typedef void (*Function)(const Lanes*, const Lanes*, const Lanes*, const double*, Lanes*);
typedef void (*Jacobian)(const Lanes*, const Lanes*, const Lanes*, const double*, Lanes*, Lanes*,
                         Lanes*, Lanes*);
typedef void (*ChainRule)(const Lanes*, const Lanes*, const Lanes*, Lanes (*)[2], Lanes (*)[NZ],
                          Lanes (*)[NZ]);

/* Value of a function of the model, at the share c of a step and the state x. If derivatives is not
   null, also its derivatives: those of x are s, and the chain rule combines them. */
INLINE void apply(Function function, Jacobian jacobian, ChainRule chain, const Row* row, double c,
                  const Lanes* t, const double* p, const Lanes* x, Lanes (*s)[NZ], Lanes* value,
                  Lanes (*derivatives)[NZ]) {
  Lanes u[2], du[NS][2], fx[SIZE_FX], fp[SIZE_FP], fu[SIZE_FU];
  input(row, c, u, du);
  if (derivatives) {
    jacobian(x, u, t, p, value, fx, fp, fu);
    chain(fx, fp, fu, du, s, derivatives);
  } else {
    function(x, u, t, p, value);
  }
}

/* Measured angles, with their derivatives unless that is null. */
INLINE void measure(const Row* row, const Lanes* t, const double* p, const Lanes* x, Lanes (*s)[NZ],
                    Lanes* angles, Lanes (*derivatives)[NZ]) {
  if (ANGLES_ARE_STATES) {
    memcpy(angles, x, 3 * sizeof(Lanes));
    if (derivatives) memcpy(derivatives, s, 3 * NZ * sizeof(Lanes));
  } else {
    apply(heli_angles, heli_angles_jacobian, chain_angles, row, 0.0, t, p, x, s, angles,
          derivatives);
  }
}

#if HAS_RESET
INLINE void chain_reset_map(const Lanes* fx, const Lanes* fp, const Lanes* fu, Lanes (*du)[2],
                            Lanes (*s)[NZ], Lanes (*out)[NZ]) {
  CHAIN_RESET_MAP;
}

/* Replaces x, and s unless that is null, by the states after the reset of a step. */
INLINE void reset(const Row* row, double c, const Lanes* t, const double* p, Lanes* x,
                  Lanes (*s)[NZ]) {
  Lanes y[NX], ys[NX][NZ];
  apply(heli_reset_map, heli_reset_map_jacobian, chain_reset_map, row, c, t, p, x, s, y,
        s ? ys : 0);
  memcpy(x, y, sizeof(y));
  if (s) memcpy(s, ys, sizeof(ys));
}
#endif

/* One Runge-Kutta step of fourth order; s is null without derivatives. */
INLINE void advance(const Row* row, double c, double share, const Lanes* t, double h,
                    const double* p, Lanes* x, Lanes (*s)[NZ]) {
  static const double at[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0, 2.0, 2.0, 1.0};
  Lanes k[NX], y[NX], sum[NX], ks[NX][NZ], ys[NX][NZ], sums[NX][NZ];
  memcpy(y, x, sizeof(y));
  memset(sum, 0, sizeof(sum));
  if (s) {
    memcpy(ys, s, sizeof(ys));
    memset(sums, 0, sizeof(sums));
  }
  for (int stage = 0; stage < 4; ++stage) {
    const Lanes stage_t = *t + h * at[stage];
    apply(heli_rates, heli_rates_jacobian, chain_rates, row, c + share * at[stage], &stage_t, p, y,
          ys, k, s ? ks : 0);
    const double next = stage < 3 ? h * at[stage + 1] : 0.0;
    for (int i = 0; i < NX; ++i) {
      sum[i] += weight[stage] * k[i];
      y[i] = x[i] + next * k[i];
      for (int j = 0; s && j < NZ; ++j) {
        sums[i][j] += weight[stage] * ks[i][j];
        ys[i][j] = s[i][j] + next * ks[i][j];
      }
    }
  }
  for (int i = 0; i < NX; ++i) {
    x[i] += h / 6.0 * sum[i];
    for (int j = 0; s && j < NZ; ++j) s[i][j] += h / 6.0 * sums[i][j];
  }
#if HAS_RESET
  const Lanes after = *t + h;
  reset(row, c + share, &after, p, x, s);
#endif
}

/* Samples whose products are added together, while a sum stays in a register. */
#define SAMPLES 4

/* Adds the products of rows [derivatives | residual] of one axis, at and below the diagonal. */
INLINE void add_products(Lanes (*rows)[NZ + 1], int count, Lanes (*normal)[NZ + 1]) {
  for (int i = 0; i <= NZ; ++i) {
    for (int j = 0; j <= i; ++j) {
      Lanes sum = normal[i][j];
      for (int m = 0; m < count; ++m) sum += rows[m][i] * rows[m][j];
      normal[i][j] = sum;
    }
  }
}

typedef struct {
  const double *mean, *change, **mean_by, **change_by;
} Voltages;

/* Voltages of the step in row r[z] of each window. */
INLINE void gather(const Voltages* voltages, const long long* r, Row* row) {
  memset(row, 0, sizeof(*row));
  for (int z = 0; z < LANES; ++z) {
    for (int i = 0; i < 2; ++i) {
      row->mean[i][z] = voltages->mean[2 * r[z] + i];
      row->change[i][z] = voltages->change[2 * r[z] + i];
      for (int j = 0; j < NS; ++j) {
        if (!voltages->mean_by[j]) continue;
        row->mean_by[j][i][z] = voltages->mean_by[j][2 * r[z] + i];
        row->change_by[j][i][z] = voltages->change_by[j][2 * r[z] + i];
      }
    }
  }
}

/* Simulates each window from x0, over one step at least; jacobian and normal are null where they
   are not wanted. */
WIDE void heli_windows(long long windows, const long long* first, const long long* steps,
                       const double* start_s, double step_s, long long substeps, const double* mean,
                       const double* change, const double** mean_by, const double** change_by,
                       const double* x0, const double* p, double* angles, double* jacobian,
                       double* end, const double* measured, const double* sigma, double* normal) {
  const Voltages voltages = {mean, change, mean_by, change_by};
  const int differentiate = jacobian != 0 || normal != 0;
  const double share = 1.0 / (double)substeps, h = step_s * share;
  Lanes x[NX], s[NX][NZ], output[3], derivatives[3][NZ], products[3][SAMPLES][NZ + 1];
  Lanes sums[3][NZ + 1][NZ + 1];
  Row row;
  for (long long w0 = 0; w0 < windows; w0 += LANES) {
    /* Lanes without a window repeat the last one, and write nothing. */
    const int lanes = windows - w0 < LANES ? (int)(windows - w0) : LANES;
    long long longest = 0;
    int waiting = 0;
    memset(s, 0, sizeof(s));
    memset(sums, 0, sizeof(sums));
    for (int z = 0; z < LANES; ++z) {
      const long long w = w0 + (z < lanes ? z : lanes - 1);
      for (int i = 0; i < NX; ++i) x[i][z] = x0[w * NX + i];
      longest = MAX(longest, steps[w]);
    }
    for (int i = 0; i < NX; ++i) s[i][i] = all(1.0);
    for (long long k = 0; k < longest; ++k) {
      long long r[LANES];
      Lanes begin_s;
      for (int z = 0; z < LANES; ++z) {
        const long long w = w0 + (z < lanes ? z : lanes - 1);
        /* A window that has ended repeats its last step. */
        r[z] = first[w] + (k < steps[w] ? k : steps[w] - 1);
        begin_s[z] = start_s[w];
      }
      gather(&voltages, r, &row);
      const Lanes t = begin_s + (double)k * step_s;
      measure(&row, &t, p, x, s, output, differentiate ? derivatives : 0);
      for (int z = 0; z < lanes; ++z) {
        if (k >= steps[w0 + z]) continue;
        for (int axis = 0; axis < 3; ++axis) {
          angles[3 * r[z] + axis] = output[axis][z];
          for (int j = 0; jacobian && j < NZ; ++j) {
            jacobian[(3 * r[z] + axis) * NZ + j] = derivatives[axis][j][z];
          }
        }
      }
      for (int axis = 0; normal && axis < 3; ++axis) {
        Lanes* product = products[axis][waiting];
        for (int j = 0; j < NZ; ++j) product[j] = derivatives[axis][j] / sigma[axis];
        for (int z = 0; z < LANES; ++z) product[NZ][z] = measured[3 * r[z] + axis];
        product[NZ] = (product[NZ] - output[axis]) / sigma[axis];
        for (int z = 0; z < lanes; ++z) {
          if (k < steps[w0 + z]) continue;
          for (int j = 0; j <= NZ; ++j) product[j][z] = 0.0;
        }
      }
      if (normal && (++waiting == SAMPLES || k + 1 == longest)) {
        for (int axis = 0; axis < 3; ++axis) add_products(products[axis], waiting, sums[axis]);
        waiting = 0;
      }
      for (long long m = 0; m < substeps; ++m) {
        const Lanes now = t + (double)m * h;
        advance(&row, (double)m * share, share, &now, h, p, x, differentiate ? s : 0);
      }
      for (int z = 0; z < lanes; ++z) {
        if (k + 1 != steps[w0 + z]) continue;
        for (int i = 0; i < NX; ++i) end[(w0 + z) * NX + i] = x[i][z];
      }
    }
    for (int z = 0; normal && z < lanes; ++z) {
      double* target = normal + 3 * (w0 + z) * (NZ + 1) * (NZ + 1);
      for (int axis = 0; axis < 3; ++axis) {
        for (int i = 0; i <= NZ; ++i) {
          for (int j = 0; j <= NZ; ++j) {
            *target++ = sums[axis][MAX(i, j)][i < j ? i : j][z];
          }
        }
      }
    }
  }
}
