% The smallest external law, for Matlab over TCP: every vehicle flies to the centre. Parameters: gain, 1/s.
% scenario: formation.external.listen = "tcp/127.0.0.1:5600"
% In real time vehicle i connects to port 5600 + i; in a study one program serves all vehicles, on port 5600.
c = tcpclient("127.0.0.1", 5603); configureTerminator(c, "LF");          % vehicle 3 in real time
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
