/* Free runs over many windows, with exact derivatives: the loop around the functions that CasADi
   wrote. `compiled.py` puts those functions before it, and these macros:

   NX, NZ, NS         numbers of states, of derivatives (by the states and the free parameters) and
                      of free parameters that change the voltages
   SIZE_*             sizes of CasADi's results, work arrays and arrays of pointers
   ANGLES_ARE_STATES  whether the measured angles are the first three states
   HAS_RESET          whether effects reset states after a step
   CHAIN_*            the chain rule, out = fx s + fp + fu du, over what is not structurally zero

   s are the sensitivities of the states, du the derivatives of the voltages. */
#include <string.h>

/* Rows of derivatives are as long as whole vectors. */
#define NP ((NZ + 4) / 4 * 4)

/* Loops over the derivatives are worth vectorising, and are compiled for wider vectors too where
   the loader can choose. Nothing is contracted: every machine finds the same numbers. */
#if defined(__GNUC__) && !defined(__clang__)
#define INLINE static inline __attribute__((always_inline))
#if defined(__x86_64__) && defined(__linux__)
#define WIDE __attribute__((optimize("O3"), target_clones("avx2", "default")))
#else
#define WIDE __attribute__((optimize("O3")))
#endif
#else
#define INLINE static
#define WIDE
#endif

INLINE void chain_rates(const double* fx, const double* fp, const double* fu, double (*du)[2],
                        double (*s)[NP], double (*out)[NP]) {
  CHAIN_RATES;
}

INLINE void chain_angles(const double* fx, const double* fp, const double* fu, double (*du)[2],
                         double (*s)[NP], double (*out)[NP]) {
  CHAIN_ANGLES;
}

typedef struct {
  const double *mean, *change, *mean_by[NS], *change_by[NS];
} Row;

/* Voltages u at the share c, 0 to 1, of a step, with their derivatives. */
INLINE void input(const Row* row, double c, double* u, double (*du)[2]) {
  for (int i = 0; i < 2; ++i) {
    u[i] = row->mean[i] + (c - 0.5) * row->change[i];
    for (int j = 0; j < NS; ++j) {
      du[j][i] = row->mean_by[j] ? row->mean_by[j][i] + (c - 0.5) * row->change_by[j][i] : 0.0;
    }
  }
}

typedef int (*Function)(const double**, double**, long long*, double*, int);
typedef void (*ChainRule)(const double*, const double*, const double*, double (*)[2],
                          double (*)[NP], double (*)[NP]);

/* Value of a function that CasADi wrote, at the share c of a step and the state x. If derivatives
   is not null, also its derivatives: those of x are s, and the chain rule combines them. */
INLINE void apply(Function function, Function jacobian, ChainRule chain, const Row* row, double c,
                  double t, const double* p, const double* x, double (*s)[NP], double* value,
                  double (*derivatives)[NP]) {
  double u[2], du[NS][2], fx[SIZE_FX], fp[SIZE_FP], fu[SIZE_FU], w[SIZE_W];
  long long iw[SIZE_IW];
  const double* arg[SIZE_ARG] = {x, u, &t, p};
  double* res[SIZE_RES] = {value, fx, fp, fu};
  input(row, c, u, du);
  if (derivatives) {
    jacobian(arg, res, iw, w, 0);
    chain(fx, fp, fu, du, s, derivatives);
  } else {
    function(arg, res, iw, w, 0);
  }
}

/* Rates k of the states, with their sensitivities ks unless that is null. */
INLINE void evaluate(const Row* row, double c, double t, const double* p, const double* x,
                     double (*s)[NP], double* k, double (*ks)[NP]) {
  apply(heli_rates, heli_rates_jacobian, chain_rates, row, c, t, p, x, s, k, ks);
}

/* Measured angles, with their derivatives unless that is null. */
INLINE void measure(const Row* row, double t, const double* p, const double* x, double (*s)[NP],
                    double* angles, double (*derivatives)[NP]) {
  if (ANGLES_ARE_STATES) {
    memcpy(angles, x, 3 * sizeof(double));
    if (derivatives) memcpy(derivatives, s, 3 * NP * sizeof(double));
  } else {
    apply(heli_angles, heli_angles_jacobian, chain_angles, row, 0.0, t, p, x, s, angles,
          derivatives);
  }
}

#if HAS_RESET
INLINE void chain_reset_map(const double* fx, const double* fp, const double* fu, double (*du)[2],
                            double (*s)[NP], double (*out)[NP]) {
  CHAIN_RESET_MAP;
}

/* Replaces x, and s unless that is null, by the states after the reset of a step. */
INLINE void reset(const Row* row, double c, double t, const double* p, double* x, double (*s)[NP]) {
  double y[NX], ys[NX][NP];
  apply(heli_reset_map, heli_reset_map_jacobian, chain_reset_map, row, c, t, p, x, s, y,
        s ? ys : 0);
  memcpy(x, y, sizeof(y));
  if (s) memcpy(s, ys, sizeof(ys));
}
#endif

/* One Runge-Kutta step of fourth order; s is null without derivatives. */
INLINE void advance(const Row* row, double c, double share, double t, double h, const double* p,
                    double* x, double (*s)[NP]) {
  static const double at[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0, 2.0, 2.0, 1.0};
  double k[NX], y[NX], sum[NX], ks[NX][NP], ys[NX][NP], sums[NX][NP];
  memcpy(y, x, sizeof(y));
  memset(sum, 0, sizeof(sum));
  if (s) {
    memcpy(ys, s, sizeof(ys));
    memset(sums, 0, sizeof(sums));
  }
  for (int stage = 0; stage < 4; ++stage) {
    evaluate(row, c + share * at[stage], t + h * at[stage], p, y, ys, k, s ? ks : 0);
    const double next = stage < 3 ? h * at[stage + 1] : 0.0;
    for (int i = 0; i < NX; ++i) {
      sum[i] += weight[stage] * k[i];
      y[i] = x[i] + next * k[i];
      if (s) {
        for (int j = 0; j < NP; ++j) {
          sums[i][j] += weight[stage] * ks[i][j];
          ys[i][j] = s[i][j] + next * ks[i][j];
        }
      }
    }
  }
  for (int i = 0; i < NX; ++i) {
    x[i] += h / 6.0 * sum[i];
    if (s)
      for (int j = 0; j < NP; ++j) s[i][j] += h / 6.0 * sums[i][j];
  }
#if HAS_RESET
  reset(row, c + share, t + h, p, x, s);
#endif
}

/* Adds the products of one axis' row [derivatives | residual]. */
INLINE void add_products(const double* row, double (*normal)[NP]) {
  for (int i = 0; i <= NZ; ++i) {
    const double value = row[i];
    for (int j = 0; j < NP; ++j) normal[i][j] += value * row[j];
  }
}

/* Simulates each window from x0; jacobian and normal are null where they are not wanted. */
WIDE void heli_windows(long long windows, const long long* first, const long long* steps,
                       const double* start_s, double step_s, long long substeps, const double* mean,
                       const double* change, const double** mean_by, const double** change_by,
                       const double* x0, const double* p, double* angles, double* jacobian,
                       double* end, const double* measured, const double* sigma, double* normal) {
  double derivatives[3][NP], products[NP], sums[3][NZ + 1][NP];
  const int differentiate = jacobian != 0 || normal != 0;
  const double share = 1.0 / (double)substeps, h = step_s * share;
  double s[NX][NP];
  for (long long w = 0; w < windows; ++w) {
    double* x = end + w * NX;
    memcpy(x, x0 + w * NX, NX * sizeof(double));
    memset(s, 0, sizeof(s));
    memset(sums, 0, sizeof(sums));
    for (int i = 0; i < NX; ++i) s[i][i] = 1.0;
    for (long long k = 0; k < steps[w]; ++k) {
      const long long r = first[w] + k;
      Row row = {mean + 2 * r, change + 2 * r, {0}, {0}};
      for (int j = 0; j < NS; ++j) {
        row.mean_by[j] = mean_by[j] ? mean_by[j] + 2 * r : 0;
        row.change_by[j] = change_by[j] ? change_by[j] + 2 * r : 0;
      }
      const double t = start_s[w] + (double)k * step_s;
      measure(&row, t, p, x, s, angles + 3 * r, differentiate ? derivatives : 0);
      for (int axis = 0; jacobian && axis < 3; ++axis) {
        memcpy(jacobian + (3 * r + axis) * NZ, derivatives[axis], NZ * sizeof(double));
      }
      for (int axis = 0; normal && axis < 3; ++axis) {
        for (int j = 0; j < NP; ++j) products[j] = derivatives[axis][j] / sigma[axis];
        products[NZ] = (measured[3 * r + axis] - angles[3 * r + axis]) / sigma[axis];
        add_products(products, sums[axis]);
      }
      for (long long m = 0; m < substeps; ++m) {
        advance(&row, (double)m * share, share, t + (double)m * h, h, p, x, differentiate ? s : 0);
      }
    }
    for (int axis = 0; normal && axis < 3; ++axis) {
      double* target = normal + (3 * w + axis) * (NZ + 1) * (NZ + 1);
      for (int i = 0; i <= NZ; ++i)
        memcpy(target + i * (NZ + 1), sums[axis][i], (NZ + 1) * sizeof(double));
    }
  }
}
