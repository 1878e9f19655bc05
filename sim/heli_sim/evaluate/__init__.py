"""From symbolic expressions to numbers: the compiler of CasADi functions and the cache of its libraries."""
