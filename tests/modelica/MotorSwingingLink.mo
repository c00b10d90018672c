model MotorSwingingLink "Motor turns a crank whose pin moves a trough through a swinging link"
  parameter Real A = 8000 "torque at standstill [N.m]";
  parameter Real B = 199.8 "slope of the characteristic [N.m.s/rad]";
  parameter Real T = 0.0625 "time constant of the torque [s]";
  parameter Real J = 0.49 "inertia of the crank [kg.m2]";
  parameter Real r = 0.01 "radius of the pin [m]";
  parameter Real l = 0.05 "distance of the pivot from the centre of the crank [m]";
  parameter Real m = 180 "mass of the trough [kg]";
  parameter Real m_load = 20 "mass of the load on it [kg]";
  parameter Real d = 4000 "viscous resistance [N.s/m]";
  parameter Real c = 720e3 "stiffness of the spring [N/m]";
  Real tau(start = 8, fixed = true) "torque of the motor [N.m]";
  Real phi(start = 0, fixed = true) "angle of the crank [rad]";
  Real w(start = 40, fixed = true) "speed of the crank [rad/s]";
  Real psi "angle of the link [rad]";
  Real rho "distance of the pin from the pivot [m]";
  Real x "position of the trough [m]";
  Real v "velocity of the trough [m/s]";
  Real f "force of the link on the trough, along its line [N]";
  Real N "force of the pin, normal to the slot [N]";
equation
  tau + T*der(tau) = A - B*w;
  der(phi) = w;
  psi = atan(r*sin(phi)/(l + r*cos(phi)));
  rho = sqrt((r*sin(phi))^2 + (l + r*cos(phi))^2);
  x = l*r*sin(phi)/(l + r*cos(phi));
  v = der(x);
  (m + m_load)*der(v) = f - d*v - c*x;
  // moments about the pivot: the block slides on the link, so its force is normal to it
  N*rho = f/cos(psi)*l/cos(psi);
  J*der(w) = tau - N*r*cos(phi - psi);
end MotorSwingingLink;
