// What the proofs of the interpreter put in place of a sum of products: a number of any bits.
#pragma once

#include "law/soft_float.hpp"

namespace heli::law {

class Sum {
 public:
  void add(Bits, Bits, Bits) {}
  Bits value() const { return proofs::any<Bits>(); }
};

}  // namespace heli::law
