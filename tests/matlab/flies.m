% Flies the board at the port in the environment; prints what the test looks at, a name and a value a line.
pkg load instrument-control
h = Heli('127.0.0.1', str2double(getenv('HELI_PORT')));
printf('supply_V %g\n', h.parameters().supply_V);
printf('set %g\n', h.setParameter('travel_kp', 0.5));
try
  h.setParameter('travel_kp', 99);
catch refused
  printf('refused %s\n', refused.message);
end
% A machine that stalls for a second must not end the flight.
h.setParameter('setpoint_hold_s', 5);
h.setParameter('setpoint_land_s', 30);
h.takeOff(0);
h.setpoint(3, 12);
h.waitUntil(@(s) s.elevation_rad * 180 / pi > 2 && s.travel_rad * 180 / pi > 6, 240);
printf('flies %s\n', h.state());
h.land(120);
s = h.samples();
printf('landed %s\n', h.state());
printf('rest_deg %.2f\n', s.elevation_rad(end) * 180 / pi);
printf('gaps %d\n', sum(diff(s.tick) ~= 1));
printf('damaged %d\n', h.losses.frames);
printf('front_V %.3f\n', max(s.front_V));
printf('kp %g\n', h.parameters().travel_kp);
h.close();
