% The smallest external law, for Matlab over TCP: every vehicle flies to the centre. Parameters: gain, 1/s.
% scenario: formation.external.listen = "tcp/127.0.0.1:5600"
% A study waits on port 5600 for one program that serves all vehicles; in real time vehicle i waits on port 5600 + i.
vehicle = 0;                                  % 0: all vehicles of a study; in real time the id of the vehicle
c = tcpclient("127.0.0.1", 5600 + vehicle); configureTerminator(c, "LF");
while true
    m = jsondecode(readline(c));
    switch m.say
        case "hello", gain = m.parameters.gain; r = struct("say", "ready", "protocol", 1);
        case "ask",   v = gain * (m.goal.centre_ned_m - m.own.position_ned_m)';
                      r = struct("say", "answer", "vehicle", m.vehicle, "tick", m.tick, "velocity_ned_m_s", v);
        otherwise,    break
    end
    writeline(c, jsonencode(r));
end
