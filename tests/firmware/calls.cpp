// Calls through pointers of every kind, for test_call_graph.py.
struct Idle {
  virtual int first();
  virtual int second();
  int value;
};
struct IdleLoop {};
struct Slow {
  virtual int first(IdleLoop);
  virtual int second(IdleLoop);
  int value;
};
struct Tick {
  virtual int first();
  virtual int second();
  int value;
};
struct Table {
  int (*first)(int);
  int (*second)(int);
};
int Idle::first() { return value; }
int Idle::second() { return 2 * value; }
int Slow::first(IdleLoop) { return 5 * value; }
int Slow::second(IdleLoop) { return 6 * value; }
int Tick::first() { return 3 * value; }
int Tick::second() { return 4 * value; }
extern "C" {
int loose_first(int x) { return x + 1; }
int loose_second(int x) { return x + 2; }
extern const Table table;
const Table table = {loose_first, loose_second};
int calls_first(Idle& idle) { return 1 + idle.first(); }
int calls_slow_directly(Slow& slow) { return 1 + slow.Slow::first(IdleLoop{}); }
int calls_second_in_a_tail(Tick& tick) { return tick.second(); }
int calls_the_table(const Table*& from) { return 1 + from->second(7); }
int calls_either(Idle& idle, int which) { return 1 + (which > 3 ? idle.first() : idle.second()); }
int calls_what_it_is_given(int (*any)()) { return 1 + any(); }
int calls_a_member(Idle& idle, int (Idle::*any)()) { return 1 + (idle.*any)(); }
// In calls.s.
int meets_at_a_label(Idle& idle, int which);
int overwritten(Idle& idle, int (*any)());
int after_a_call(Idle& idle);
int behind_a_table(Idle& idle, int which);
int (*take(int))() { return nullptr; }
int main() {
  static Idle idle;
  static Tick tick;
  static Slow slow;
  static const Table* from = &table;
  return calls_slow_directly(slow) + calls_first(idle) + calls_second_in_a_tail(tick) +
         calls_the_table(from) + calls_either(idle, 5) + calls_what_it_is_given(nullptr) +
         calls_a_member(idle, &Idle::second) + meets_at_a_label(idle, 1) +
         overwritten(idle, nullptr) + after_a_call(idle) + behind_a_table(idle, 1);
}
}
