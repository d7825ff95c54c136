% The law "ring" of Skein as another program, in Octave: the field of ring.py.
% scenario: formation.external.command = ["octave-cli", "--quiet", "ring.m"]
1;  % a script, not a function file

function s = limiting(z)
  s = 1 ./ (1 + exp(min(z, 700)));
end

function [v, rho] = field(m, p)
  c = m.goal.centre_ned_m(:); h = m.goal.heading_rad; gamma = m.goal.gamma; radius = m.goal.radius_m;
  place = m.own.position_ned_m(:);
  turn = [cos(h), -sin(h); sin(h), cos(h)];
  K = log((1 - p.edge_share) / p.edge_share);
  axes_m = turn' * (place(1:2) - c(1:2));          % along the ellipse's own axes
  rho = sqrt(axes_m(1)^2 + gamma * axes_m(2)^2);
  g = [axes_m(1); gamma * axes_m(2)];
  if norm(g) < 1e-6, g = [0; 0]; else, g = turn * g / norm(g); end
  s_in = limiting(K / p.inner_width_m * (rho - (radius - p.inner_width_m)));
  s_out = 1 - limiting(K / p.outer_width_m * (rho - (radius + p.outer_width_m)));
  s_perp = (1 - s_in) * (1 - s_out);
  peers = m.peers;                                 % objects with the same keys: a struct array, [] if there are none
  n = max(numel(peers) + 1, 2);
  half = radius * sqrt(2) * sin(pi / n);
  A = [0; 0];
  for k = 1:numel(peers)
    away = place(1:2) - peers(k).position_ned_m(1:2)(:);
    d = norm(away);
    if d < 1e-3
      away = [1; 0];
      if m.vehicle > peers(k).id, away = -away; end
    else
      away = away / d;
    end
    A = A + limiting(K / half * (d - half)) * away;
  end
  if norm(A) > 2, A = 2 * A / norm(A); end
  v = (s_in - s_out) * g + A - s_perp * (A' * g) * g;
end

p = struct("inner_width_m", 20, "outer_width_m", 20, "edge_share", 0.01);
while true
  m = jsondecode(input("", "s"));  % fgetl(stdin) waits for the first byte of the next line, which comes after the answer
  switch m.say
    case "hello"
      for key = fieldnames(m.parameters)', p.(key{1}) = m.parameters.(key{1}); end
      reply = struct("say", "ready", "protocol", 1);
    case "ask"
      [v, rho] = field(m, p);
      slow = norm(m.own.velocity_ned_m_s(1:2) - m.goal.centre_velocity_ned_m_s(1:2)) < 0.5;
      there = rho >= m.goal.radius_m - p.inner_width_m && rho <= m.goal.radius_m + p.outer_width_m;
      reply = struct("say", "answer", "vehicle", m.vehicle, "tick", m.tick, "field_ne", v', ...
                     "reached", there && slow && norm(v) < 0.15, "log", struct("rho_m", rho));
    otherwise
      break
  end
  % jsonencode writes 15 digits; the field needs no more.
  fprintf(stdout, "%s\n", jsonencode(reply)); fflush(stdout);
end
