"""The kernel in C: rates and Jacobians that CasADi wrote, and a loop around them, compiled together."""

from __future__ import annotations

import ctypes
import itertools
from collections.abc import Callable
from typing import Final

import casadi as ca
import numpy as np
from heli_host.arrays import Floats
from heli_sim.compiled import c_source
from heli_sim.errors import PlantError
from typing_extensions import override

from heli_lab.identify.free_run.functions import Functions, Inputs
from heli_lab.identify.free_run.interface import Kernel
from heli_lab.threads import parallel_map

_WORTH_THREADS_ROWS: Final = 500
"""Steps from which on a second thread saves more than it costs to start."""

_C: Final = """
#include <string.h>
#define NX %(nx)d
#define NZ %(nz)d
/* Rows of derivatives are as long as whole vectors. */
#define NP ((NZ + 4) / 4 * 4)

#define NS %(ns)d

/* Loops over the derivatives are worth vectorising, and are compiled for wider vectors too where the
   loader can choose. Nothing is contracted: every machine finds the same numbers. */
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
%(rates)s}

INLINE void chain_angles(const double* fx, const double* fp, const double* fu, double (*du)[2],
                         double (*s)[NP], double* target) {
  double (*out)[NP] = (double (*)[NP])target;
%(angles)s}

typedef struct { const double *mean, *change, *mean_by[NS], *change_by[NS]; } Row;

INLINE void input(const Row* row, double c, double* u, double (*du)[2]) {
  for (int i = 0; i < 2; ++i) {
    u[i] = row->mean[i] + (c - 0.5) * row->change[i];
    for (int j = 0; j < NS; ++j) {
      du[j][i] = row->mean_by[j] ? row->mean_by[j][i] + (c - 0.5) * row->change_by[j][i] : 0.0;
    }
  }
}

INLINE void evaluate(const Row* row, double c, double t, const double* p, double* x, double (*s)[NP],
                     double* k, double (*ks)[NP]) {
  double u[2], du[NS][2], fx[%(fx)d], fp[%(fp)d], fu[%(fu)d], w[%(w)d];
  long long iw[%(iw)d];
  const double* arg[%(arg)d] = {x, u, &t, p};
  double* res[%(res)d] = {k, fx, fp, fu};
  input(row, c, u, du);
  if (ks) {
    heli_rates_jacobian(arg, res, iw, w, 0);
    chain_rates(fx, fp, fu, du, s, ks);
  } else {
    heli_rates(arg, res, iw, w, 0);
  }
}

INLINE void measure(const Row* row, double t, const double* p, double* x, double (*s)[NP], double* angles,
                 double* target) {
  double u[2], du[NS][2], fx[%(fx)d], fp[%(fp)d], fu[%(fu)d], w[%(w)d];
  long long iw[%(iw)d];
  const double* arg[%(arg)d] = {x, u, &t, p};
  double* res[%(res)d] = {angles, fx, fp, fu};
  if (%(identity)d) {
    memcpy(angles, x, 3 * sizeof(double));
    if (target) memcpy(target, s, 3 * NP * sizeof(double));
    return;
  }
  input(row, 0.0, u, du);
  if (target) {
    heli_angles_jacobian(arg, res, iw, w, 0);
    chain_angles(fx, fp, fu, du, s, target);
  } else {
    heli_angles(arg, res, iw, w, 0);
  }
}

%(reset)s
/* One step; s is null without derivatives. */
INLINE void advance(const Row* row, double c, double share, double t, double h, const double* p, double* x,
                    double (*s)[NP]) {
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
    if (s) for (int j = 0; j < NP; ++j) s[i][j] += h / 6.0 * sums[i][j];
  }
%(call_reset)s}

/* Adds the products of one axis' row [derivatives | residual]. */
INLINE void add_products(const double* row, double (*normal)[NP]) {
  for (int i = 0; i <= NZ; ++i) {
    const double value = row[i];
    for (int j = 0; j < NP; ++j) normal[i][j] += value * row[j];
  }
}

WIDE
void heli_windows(long long windows, const long long* first, const long long* steps, const double* start_s,
                  double step_s, long long substeps, const double* mean, const double* change,
                  const double** mean_by, const double** change_by, const double* x0,
                  const double* p, double* angles, double* jacobian, double* end,
                  const double* measured, const double* sigma, double* normal) {
  double derivatives[3][NP], products[NP], sums[3][NZ + 1][NP];
  const int with = jacobian != 0 || normal != 0;
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
      measure(&row, t, p, x, s, angles + 3 * r, with ? derivatives[0] : 0);
      for (int axis = 0; jacobian && axis < 3; ++axis) {
        memcpy(jacobian + (3 * r + axis) * NZ, derivatives[axis], NZ * sizeof(double));
      }
      for (int axis = 0; normal && axis < 3; ++axis) {
        for (int j = 0; j < NP; ++j) products[j] = derivatives[axis][j] / sigma[axis];
        products[NZ] = (measured[3 * r + axis] - angles[3 * r + axis]) / sigma[axis];
        add_products(products, sums[axis]);
      }
      for (long long m = 0; m < substeps; ++m) {
        advance(&row, (double)m * share, share, t + (double)m * h, h, p, x, with ? s : 0);
      }
    }
    for (int axis = 0; normal && axis < 3; ++axis) {
      double* target = normal + (3 * w + axis) * (NZ + 1) * (NZ + 1);
      for (int i = 0; i <= NZ; ++i) memcpy(target + i * (NZ + 1), sums[axis][i], (NZ + 1) * sizeof(double));
    }
  }
}
"""


# The map that effects reset their states by after a step.
_RESET: Final = """
INLINE void chain_reset_map(const double* fx, const double* fp, const double* fu, double (*du)[2],
                          double (*s)[NP], double (*out)[NP]) {
%(chain)s}

INLINE void reset(const Row* row, double c, double t, const double* p, double* x, double (*s)[NP]) {
  double u[2], du[NS][2], fx[%(fx)d], fp[%(fp)d], fu[%(fu)d], w[%(w)d], y[NX], ys[NX][NP];
  long long iw[%(iw)d];
  const double* arg[%(arg)d] = {x, u, &t, p};
  double* res[%(res)d] = {y, fx, fp, fu};
  input(row, c, u, du);
  if (s) {
    heli_reset_map_jacobian(arg, res, iw, w, 0);
    chain_reset_map(fx, fp, fu, du, s, ys);
    memcpy(s, ys, sizeof(ys));
  } else {
    heli_reset_map(arg, res, iw, w, 0);
  }
  memcpy(x, y, sizeof(y));
}
"""


def _chain(functions: Functions, function: ca.Function) -> str:
    """C lines for out = fx s + fp + fu du, one by one over what is not structurally zero."""
    lines = []
    fx = _nonzeros(function.sparsity_out(1))
    for row in range(function.size1_out(0)):
        terms = [f"fx[{k}] * s[{j}][z]" for k, (i, j) in enumerate(fx) if i == row]
        lines.append(f"  for (int z = 0; z < NP; ++z) out[{row}][z] = {' + '.join(terms) or '0.0'};")
    for k, (i, j) in enumerate(_nonzeros(function.sparsity_out(2))):
        lines.append(f"  out[{i}][{functions.state_count + j}] += fp[{k}];")
    for which, name in enumerate(functions.voltage_parameters):
        column = functions.state_count + functions.free.index(name)
        for k, (i, j) in enumerate(_nonzeros(function.sparsity_out(3))):
            lines.append(f"  out[{i}][{column}] += fu[{k}] * du[{which}][{j}];")
    return "\n".join(["  (void)fp, (void)fu, (void)du;", *lines, ""])


def _nonzeros(sparsity: ca.Sparsity) -> list[tuple[int, int]]:
    rows, columns = sparsity.get_triplet()
    return list(zip(rows, columns, strict=True))


def driver(functions: Functions) -> str:
    """Write the kernel: one C file with the function heli_windows."""
    sizes = [function.sz_arg() for function in functions.all], [f.sz_res() for f in functions.all]
    jacobians = (functions.rates_jacobian, functions.angles_jacobian, functions.reset_map_jacobian)
    nonzeros = [max(f.nnz_out(i) for f in jacobians) for i in (1, 2, 3)]
    sized = {
        "nx": functions.state_count,
        "nz": functions.state_count + len(functions.free_index),
        "ns": max(1, len(functions.voltage_parameters)),
        "identity": functions.identity,
        "chain": _chain(functions, functions.reset_map_jacobian),
        "arg": max(4, *sizes[0]),
        "res": max(4, *sizes[1]),
        "iw": max(1, *(f.sz_iw() for f in functions.all)),
        "w": max(1, *(f.sz_w() for f in functions.all)),
        **dict(zip(("fx", "fp", "fu"), (max(1, n) for n in nonzeros), strict=True)),
        "rates": _chain(functions, functions.rates_jacobian),
        "angles": _chain(functions, functions.angles_jacobian),
    }
    sized["reset"] = _RESET % sized if functions.has_reset else ""
    sized["call_reset"] = "  reset(row, c + share, t + h, p, x, s);\n" if functions.has_reset else ""
    return c_source(*functions.all) + _C % sized


class CompiledKernel(Kernel):
    """Windows run by compiled code.

    Parameters
    ----------
    library : str
        Path of the shared library.
    threads : int
        Threads that share out the windows, 1 or more.

    Raises
    ------
    PlantError
        When the library does not load.
    """

    def __init__(self, functions: Functions, library: str, threads: int = 1) -> None:
        self._threads = threads
        self._sizes = functions.state_count, functions.state_count + len(functions.free_index)
        self._voltage_parameters = functions.voltage_parameters
        try:
            self._windows: Callable[..., None] = ctypes.CDLL(library).heli_windows
        except (OSError, AttributeError) as error:
            raise PlantError(f"the compiled model does not load: {error}", f"delete {library}") from None
        self._windows.restype = None

    @override
    def predict(self, inputs: Inputs, start: Floats, parameters: Floats) -> tuple[Floats, Floats]:
        return self._call(inputs, start, parameters)

    @override
    def jacobian(self, inputs: Inputs, start: Floats, parameters: Floats) -> tuple[Floats, Floats]:
        jacobian = np.empty((inputs.rows, 3, self._sizes[1]))
        angles, _ = self._call(inputs, start, parameters, jacobian)
        return angles, jacobian

    @override
    def products(
        self, inputs: Inputs, start: Floats, parameters: Floats, measured_rad: Floats, sigma_rad: Floats
    ) -> tuple[Floats, Floats]:
        size = self._sizes[1] + 1
        normal_matrix = np.zeros((len(inputs.steps), 3, size, size))
        angles, _ = self._call(inputs, start, parameters, None, (measured_rad, sigma_rad, normal_matrix))
        return angles, normal_matrix

    def _call(
        self,
        inputs: Inputs,
        start: Floats,
        parameters: Floats,
        jacobian: Floats | None = None,
        products: tuple[Floats | None, Floats | None, Floats | None] = (None, None, None),
    ) -> tuple[Floats, Floats]:
        """Run every window in C, and fill the arrays that are given.

        Parameters
        ----------
        jacobian : ndarray (n, 3, states + f), optional
            Filled with the derivatives of the angles.
        products : (ndarray (n, 3), ndarray (3,), ndarray (w, 3, states + f + 1, states + f + 1)), optional
            Measured angles, unit of the residuals, and the normal matrices, which are filled.

        Returns
        -------
        angles_rad : ndarray (n, 3)
            Measured angles at the beginning of each step.
        end : ndarray (w, states)
            States at the end of each window.
        """
        states = self._sizes[0]
        windows = len(inputs.steps)
        angles = np.empty((inputs.rows, 3))
        end = np.empty((windows, states))
        measured, sigma, normal_matrix = (None, None, None) if products is None else products
        if measured is not None and sigma is not None:
            measured, sigma = np.ascontiguousarray(measured, float), np.ascontiguousarray(sigma, float)
        mean, change = np.ascontiguousarray(inputs.mean_V), np.ascontiguousarray(inputs.change_V)
        of_mean = {name: np.ascontiguousarray(array) for name, array, _ in inputs.voltage_derivatives}
        of_change = {name: np.ascontiguousarray(array) for name, _, array in inputs.voltage_derivatives}
        mean_by, change_by = self._pointers(of_mean), self._pointers(of_change)
        x0, p = np.ascontiguousarray(start, float), np.ascontiguousarray(parameters, float)
        first, steps = inputs.first, np.ascontiguousarray(inputs.steps, np.int64)
        start_s = np.ascontiguousarray(inputs.start_s, float)

        def run_windows(low: int, high: int) -> None:
            """Run the windows `low` to `high` - 1 in C."""
            self._windows(
                ctypes.c_longlong(high - low),
                *(ctypes.c_void_p(array[low:].ctypes.data) for array in (first, steps, start_s)),
                ctypes.c_double(inputs.step_s),
                ctypes.c_longlong(inputs.substeps),
                ctypes.c_void_p(mean.ctypes.data),
                ctypes.c_void_p(change.ctypes.data),
                mean_by,
                change_by,
                ctypes.c_void_p(x0[low:].ctypes.data),
                ctypes.c_void_p(p.ctypes.data),
                ctypes.c_void_p(angles.ctypes.data),
                None if jacobian is None else ctypes.c_void_p(jacobian.ctypes.data),
                ctypes.c_void_p(end[low:].ctypes.data),
                None if measured is None else ctypes.c_void_p(measured.ctypes.data),
                None if sigma is None else ctypes.c_void_p(sigma.ctypes.data),
                None if normal_matrix is None else ctypes.c_void_p(normal_matrix[low:].ctypes.data),
            )

        # The call releases Python's lock.
        if self._threads == 1 or windows < 2 or inputs.rows < _WORTH_THREADS_ROWS:
            run_windows(0, windows)
            return angles, end
        # Each thread gets consecutive windows with about the same number of steps.
        steps_before = inputs.rows * np.arange(1, self._threads) / self._threads
        inner = np.minimum(np.searchsorted(np.cumsum(steps), steps_before) + 1, windows)
        edges = [0, *(int(edge) for edge in np.unique(inner) if edge < windows), windows]
        parallel_map(lambda ends: run_windows(*ends), list(itertools.pairwise(edges)), self._threads)
        return angles, end

    def _pointers(self, arrays: dict[str, Floats]) -> ctypes.Array[ctypes.c_void_p]:
        """Addresses of `arrays`, in the order of the voltage parameters; null for a parameter without one."""
        addresses = [
            arrays[name].ctypes.data if name in arrays else None for name in self._voltage_parameters
        ]
        return (ctypes.c_void_p * max(1, len(addresses)))(*addresses)
