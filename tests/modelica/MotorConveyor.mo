model MotorConveyor "Motor with a lagging linear torque turns the crank of a slider-crank conveyor"
  parameter Real A = 8000 "torque at standstill [N.m]";
  parameter Real B = 199.8 "slope of the characteristic [N.m.s/rad]";
  parameter Real T = 0.0625 "time constant of the torque [s]";
  parameter Real J = 0.49 "inertia of the crank [kg.m2]";
  parameter Real r = 0.01 "radius of the crank [m]";
  parameter Real l = 0.4 "length of the rod [m]";
  parameter Real m = 200 "mass of the trough [kg]";
  parameter Real d = 4000 "viscous resistance [N.s/m]";
  parameter Real c = 720e3 "stiffness of the spring [N/m]";
  Real tau(start = 8, fixed = true) "torque of the motor [N.m]";
  Real phi(start = 0, fixed = true) "angle of the crank [rad]";
  Real w(start = 40, fixed = true) "speed of the crank [rad/s]";
  Real delta "angle between the rod and the line of the trough [rad]";
  Real x "position of the trough [m]";
  Real v "velocity of the trough [m/s]";
  Real S "axial force of the rod, a two-force member [N]";
equation
  tau + T*der(tau) = A - B*w;
  der(phi) = w;
  delta = asin(r*cos(phi)/l);
  x = r*sin(phi) + sqrt(l^2 - (r*cos(phi))^2) - l;
  v = der(x);
  m*der(v) = S*cos(delta) - d*v - c*x;
  J*der(w) = tau - S*r*cos(phi - delta);
end MotorConveyor;
