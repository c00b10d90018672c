// What carries a torque from one machine to another.

model Shaft "Elastic shaft without backlash"
  parameter Real c = 1000;
  parameter Real d = 5;
  parameter Real twist0 = 0;
  input Real w_a;
  input Real w_b;
  Real twist(start = twist0, fixed = true);
  output Real tau_a;
  output Real tau_b;
equation
  der(twist) = w_a - w_b;
  tau_b = c * twist + d * der(twist);
  tau_a + tau_b = 0;
end Shaft;

model PlayingShaft "Elastic shaft whose flanks part within the backlash and never pull"
  parameter Real c = 1000;
  parameter Real d = 5;
  parameter Real b = 0.02;
  parameter Real twist0 = -0.03;
  input Real w_a;
  input Real w_b;
  Real twist(start = twist0, fixed = true);
  output Real tau_a;
  output Real tau_b;
protected
  Real spring;
  Real both;
equation
  der(twist) = w_a - w_b;
  spring = if noEvent(twist > b / 2) then c * (twist - b / 2) elseif noEvent(twist < -b / 2) then c * (twist + b / 2) else 0;
  both = spring + d * der(twist);
  tau_b = if noEvent(spring > 0) then (if noEvent(both < 0) then 0 elseif noEvent(both > 2 * spring) then 2 * spring else both)
    elseif noEvent(spring < 0) then (if noEvent(both > 0) then 0 elseif noEvent(both < 2 * spring) then 2 * spring else both)
    else 0;
  tau_a + tau_b = 0;
end PlayingShaft;

model Gear "Ratio and efficiency, the same whichever side drives; friction fades out below a small speed"
  parameter Real ratio = 5;
  parameter Real eta = 0.9;
  parameter Real J = 0.01;
  parameter Real w_small = 0.1;
  parameter Real w0 = 100;
  input Real tau_a;
  input Real tau_b;
  output Real w_a(start = w0, fixed = true);
  output Real w_b;
protected
  Real load "torque of shaft b at shaft a, without losses";
  Real lossy "the same with the losses of full speed";
  Real share;
equation
  ratio * w_b = w_a;
  load * ratio = tau_b;
  lossy = if noEvent(load * w_a < 0) then load / eta else load * eta;
  share = if noEvent(abs(w_a) < w_small) then abs(w_a) / w_small else 1;
  J * der(w_a) = tau_a + load + share * (lossy - load);
end Gear;
