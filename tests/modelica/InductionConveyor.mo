model InductionConveyor "Induction motor (Kloss) with a lag turns a crank whose rod is very long"
  parameter Real tau_b = 190 "breakdown torque [N.m]";
  parameter Real s_b = 0.16 "breakdown slip";
  parameter Real w_s = 65.4 "synchronous speed [rad/s]";
  parameter Real T = 0.0625 "time constant of the torque [s]";
  parameter Real J = 0.49 "inertia of the crank [kg.m2]";
  parameter Real r = 0.01 "radius of the crank [m]";
  parameter Real m = 200 "mass of the trough [kg]";
  parameter Real d = 4000 "viscous resistance [N.s/m]";
  parameter Real c = 720e3 "stiffness of the spring [N/m]";
  Real tau(start = 8, fixed = true) "torque of the motor [N.m]";
  Real phi(start = 0, fixed = true) "angle of the crank [rad]";
  Real w(start = 40, fixed = true) "speed of the crank [rad/s]";
  Real s "slip";
  Real x "position of the trough [m]";
  Real v "velocity of the trough [m/s]";
  Real F "force of the rod on the trough [N]";
equation
  s = (w_s - w)/w_s;
  tau + T*der(tau) = 2*tau_b/(s/s_b + s_b/s);
  der(phi) = w;
  x = r*sin(phi);
  v = der(x);
  m*der(v) = F - d*v - c*x;
  J*der(w) = tau - F*r*cos(phi);
end InductionConveyor;
