// Machines with a crank or a rotor, as free bodies that are held together by constraints: Newton's laws for each mass,
// the force between them as an unknown, and the geometry as an equation. No reduced inertia and no Lagrange equation.
// Mechanisms: I. I. Artobolevsky, Mechanisms in modern engineering design. Rotor on a mount: S. Timoshenko,
// Vibration problems in engineering.

model Conveyor "Crank, rod and trough; the rod is so long that it stays along x"
  parameter Real theta = 0.49;
  parameter Real r = 0.01;
  parameter Real m = 200;
  parameter Real alpha = 4000;
  parameter Real c = 720000;
  parameter Real phi0 = 0;
  parameter Real w0 = 40;
  input Real tau;
  Real phi(start = phi0, fixed = true);
  output Real w(start = w0, fixed = true);
  Real x;
  Real v;
  Real force "of the rod on the trough";
equation
  der(phi) = w;
  x = r * sin(phi);
  der(x) = v;
  m * der(v) = force - c * x - alpha * v;
  theta * der(w) = tau - force * r * cos(phi);
end Conveyor;

model SliderCrank "Crank, rod of finite length and trough"
  parameter Real theta = 0.49;
  parameter Real r = 0.01;
  parameter Real l = 0.4;
  parameter Real m = 200;
  parameter Real alpha = 4000;
  parameter Real c = 720000;
  parameter Real phi0 = 0;
  parameter Real w0 = 40;
  input Real tau;
  Real phi(start = phi0, fixed = true);
  output Real w(start = w0, fixed = true);
  Real x;
  Real v;
  Real tilt "angle of the rod with x";
  Real force "of the rod, along the rod";
equation
  der(phi) = w;
  l * sin(tilt) = r * cos(phi);
  x = r * sin(phi) + l * cos(tilt) - l;
  der(x) = v;
  m * der(v) = force * cos(tilt) - c * x - alpha * v;
  theta * der(w) = tau - force * r * cos(phi - tilt);
end SliderCrank;

model Yoke "Crank pin in the slot of a link that slides along x"
  parameter Real theta = 0.49;
  parameter Real r = 0.01;
  parameter Real m = 180;
  parameter Real alpha = 4000;
  parameter Real c = 720000;
  parameter Real m_load = 20;
  parameter Real phi0 = 0;
  parameter Real w0 = 40;
  input Real tau;
  Real phi(start = phi0, fixed = true);
  output Real w(start = w0, fixed = true);
  Real x;
  Real v;
  Real force "of the pin on the slot, along x";
  Real load "of the load on the trough, along -x";
equation
  der(phi) = w;
  x = r * sin(phi);
  der(x) = v;
  load = m_load * der(v) + alpha * v + c * x;
  m * der(v) = force - load;
  theta * der(w) = tau - force * r * cos(phi);
end Yoke;

model SwingingLink "Crank pin in the slot of a link that turns about a pivot below the crank"
  parameter Real theta = 0.49;
  parameter Real r = 0.01;
  parameter Real l = 0.05;
  parameter Real m = 180;
  parameter Real alpha = 4000;
  parameter Real c = 720000;
  parameter Real m_load = 20;
  parameter Real phi0 = 0;
  parameter Real w0 = 40;
  input Real tau;
  Real phi(start = phi0, fixed = true);
  output Real w(start = w0, fixed = true);
  Real x;
  Real v;
  Real load;
  Real psi "angle of the link with the line from the pivot to the centre of the crank";
  Real arm "from the pivot to the pin";
  Real normal "force of the pin, across the slot";
equation
  der(phi) = w;
  x * (l + r * cos(phi)) = l * r * sin(phi) "similar triangles";
  psi = atan(x / l);
  arm * arm = l * l + r * r + 2 * l * r * cos(phi);
  der(x) = v;
  load = m_load * der(v) + alpha * v + c * x;
  normal * arm = (m * der(v) + load) * l / cos(psi) ^ 2 "moments about the pivot";
  theta * der(w) = tau - normal * r * cos(phi - psi);
end SwingingLink;

model Exciter "Eccentric mass that turns in a body on a spring and a damper"
  parameter Real J = 0.02;
  parameter Real m_u = 0.5;
  parameter Real r = 0.05;
  parameter Real friction = 0.005;
  parameter Real m = 19.5;
  parameter Real c = 50000;
  parameter Real d = 80;
  parameter Real phi0 = 0;
  parameter Real w0 = 0;
  parameter Real x0 = 0;
  parameter Real v0 = 0;
  input Real tau;
  Real phi(start = phi0, fixed = true);
  output Real w(start = w0, fixed = true);
  Real x(start = x0, fixed = true);
  Real v(start = v0, fixed = true);
  Real v_x "velocity of the eccentric mass";
  Real v_y;
  Real f_x "force on the eccentric mass";
  Real f_y;
equation
  der(phi) = w;
  der(x) = v;
  v_x = v - r * w * sin(phi);
  v_y = r * w * cos(phi);
  m_u * der(v_x) = f_x;
  m_u * der(v_y) = f_y;
  m * der(v) = -f_x - c * x - d * v;
  J * der(w) = tau - friction * w + r * sin(phi) * f_x - r * cos(phi) * f_y;
end Exciter;
