// What the proofs of the interpreter put in place of a sum of products: results.
#pragma once

#include "law/soft_float.hpp"

namespace heli::law {

class Sum {
 public:
  void add(Bits a, Bits b, Bits) { sum_ = result_of(sum_, result_of(a, b)); }
  Bits value() const { return sum_; }

 private:
  Bits sum_ = 0;
};

}  // namespace heli::law
