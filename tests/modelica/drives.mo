// Whole drives, put together from motors.mo, machines.mo and shafts.mo.

model DriveA "Stiff drive and conveyor"
  LinearMotor motor;
  Conveyor conveyor;
equation
  conveyor.tau = motor.tau;
  motor.w = conveyor.w;
end DriveA;

model DriveB "Induction motor and conveyor with a rod of finite length"
  KlossMotor motor;
  SliderCrank conveyor;
equation
  conveyor.tau = motor.tau;
  motor.w = conveyor.w;
end DriveB;

model ControlledChain "Controller, direct-current motor, gearbox, shaft and conveyor"
  parameter Real gain = 2.5;
  parameter Real w_ref = 150;
  Controller controller;
  DirectCurrentMotor motor;
  Gear gear;
  Shaft shaft(c = 4000);
  Conveyor conveyor;
equation
  controller.w_ref = w_ref;
  controller.w = gear.w_a;
  motor.v = gain * controller.tau;
  motor.w = gear.w_a;
  gear.tau_a = motor.tau;
  gear.tau_b = shaft.tau_a;
  shaft.w_a = gear.w_b;
  shaft.w_b = conveyor.w;
  conveyor.tau = shaft.tau_b;
end ControlledChain;

model ShakenMotor "Direct-current motor on an unbalanced rotor"
  parameter Real supply = 24;
  DirectCurrentMotor motor;
  Exciter exciter;
equation
  motor.v = supply;
  motor.w = exciter.w;
  exciter.tau = motor.tau;
end ShakenMotor;

model LooseChain "Drive, gearbox, shaft with backlash and yoke"
  LinearMotor motor(A = 800, B = 10, T = 0.02, tau0 = 10);
  Gear gear(ratio = 2, w0 = 80);
  PlayingShaft shaft(c = 20000, d = 20, b = 0.01, twist0 = 0.004);
  Yoke yoke;
equation
  motor.w = gear.w_a;
  gear.tau_a = motor.tau;
  gear.tau_b = shaft.tau_a;
  shaft.w_a = gear.w_b;
  shaft.w_b = yoke.w;
  yoke.tau = shaft.tau_b;
end LooseChain;

model LinkDrive "Stiff drive and swinging link"
  LinearMotor motor;
  SwingingLink link;
equation
  link.tau = motor.tau;
  motor.w = link.w;
end LinkDrive;

model GearedExciter "Direct-current motor, gearbox, shaft and unbalanced rotor"
  parameter Real supply = 48;
  DirectCurrentMotor motor(i0 = 10);
  Gear gear;
  Shaft shaft(twist0 = 0.001);
  Exciter exciter(w0 = 20);
equation
  motor.v = supply;
  motor.w = gear.w_a;
  gear.tau_a = motor.tau;
  gear.tau_b = shaft.tau_a;
  shaft.w_a = gear.w_b;
  shaft.w_b = exciter.w;
  exciter.tau = shaft.tau_b;
end GearedExciter;
