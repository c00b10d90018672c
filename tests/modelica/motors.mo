// Motors and their controller. Sources: V. I. Klyuchev, Theory of the electric drive (lag of the torque); M. Kloss, Archiv fuer
// Elektrotechnik 5 (1916) (torque over slip); A. E. Fitzgerald, Electric machinery (direct-current machine);
// K. J. Astrom and T. Hagglund, PID controllers (back-calculation).

model LinearMotor "Torque that follows a falling line with a lag"
  parameter Real A = 8000;
  parameter Real B = 199.8;
  parameter Real T = 0.0625;
  parameter Real tau0 = 8;
  input Real w;
  output Real tau(start = tau0, fixed = true);
equation
  tau + T * der(tau) = A - B * w;
end LinearMotor;

model KlossMotor "Torque that follows the characteristic of an induction machine with a lag"
  parameter Real tau_b = 190 "breakdown torque";
  parameter Real s_b = 0.16 "breakdown slip";
  parameter Real w_s = 65.4 "synchronous speed";
  parameter Real T = 0.0625;
  parameter Real tau0 = 8;
  input Real w;
  output Real tau(start = tau0, fixed = true);
protected
  Real slip;
equation
  slip = (w_s - w) / w_s;
  (tau + T * der(tau)) * (slip * slip + s_b * s_b) = 2 * tau_b * slip * s_b;
end KlossMotor;

model DirectCurrentMotor "Winding that turns in a constant field"
  parameter Real R = 0.5;
  parameter Real L = 0.002;
  parameter Real k = 0.2;
  parameter Real i0 = 0;
  input Real v;
  input Real w;
  Real i(start = i0, fixed = true);
  output Real tau;
equation
  v = R * i + L * der(i) + k * w;
  tau = k * i;
end DirectCurrentMotor;

model Controller "Proportional and integral control with back-calculation at the limit"
  parameter Real K = 2;
  parameter Real T_i = 0.5;
  parameter Real T_t = 0.1;
  parameter Real limit = 30;
  parameter Real integral0 = 0;
  input Real w_ref;
  input Real w;
  Real integral(start = integral0, fixed = true);
  Real wanted;
  output Real tau;
equation
  wanted = K * (w_ref - w) + integral;
  tau = if noEvent(wanted > limit) then limit elseif noEvent(wanted < -limit) then -limit else wanted;
  der(integral) = K * (w_ref - w) / T_i + (tau - wanted) / T_t;
end Controller;
