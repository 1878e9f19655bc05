// The arithmetic of Arduino's PID_v1, written anew from its documentation for comparison of cost:
// three loops, proportional on error, derivative on measurement, output limited, integral limited
// to the output's range. In double as there, which on a Due takes 64 bits. No gains of the rig, no
// filters, no feed-forward, no mixer: everything that the firmware's law does besides.
namespace {

struct Loop {
  double kp, ki, kd;
  double least, most;
  double integral, last_input;
};

double clamp(double value, double least, double most) {
  if (value > most) return most;
  return value < least ? least : value;
}

double compute(Loop& loop, double setpoint, double input) {
  const double error = setpoint - input;
  const double change = input - loop.last_input;
  loop.integral = clamp(loop.integral + loop.ki * error, loop.least, loop.most);
  loop.last_input = input;
  return clamp(loop.kp * error + loop.integral - loop.kd * change, loop.least, loop.most);
}

Loop travel{2.2, 0.00006, 3300.0, -20.0, 20.0, 0.0, 0.0};
Loop pitch{0.25, 0.00002, 43.0, -1.4, 1.4, 0.0, 0.0};
Loop elevation{0.39, 0.00008, 180.0, 0.0, 18.0, 0.0, 0.0};
volatile double angle_deg[3];
volatile double collective_V;
volatile double differential_V;

}  // namespace

extern "C" [[gnu::noinline]] void three_loops() {
  const double pitch_deg = compute(travel, 10.0, angle_deg[2]);
  differential_V = compute(pitch, pitch_deg, angle_deg[1]);
  collective_V = compute(elevation, 5.0, angle_deg[0]);
}

int main() {
  for (unsigned tick = 0;; ++tick) {
    // A sawtooth in encoder counts, so that neither limits nor zeros cut the arithmetic short.
    for (int axis = 0; axis < 3; ++axis) {
      angle_deg[axis] = 0.087890625 * static_cast<double>(tick * (axis + 1U) % 16U);
    }
    three_loops();
  }
}
