% A study of the shipped hover formation, for Matlab and Octave: how much loss on the network does it bear?
% Run it in the folder of this file, beside skein_table.m: `octave-cli study.m`, or `study` in Matlab.

name = 'study';                                  % folder of the results
seeds = 20;                                      % runs at each loss

% A second start of an interrupted study continues it.
status = system(sprintf('skein study hover --seeds 0..%d --sweep network.loss=0,0.1,0.3 --no-record --out %s', seeds, name));
if status ~= 0, error('skein study ended with status %d', status); end

t = skein_table([name '/runs.csv']);             % a field for each column: t.seed, t.network_loss, t.in_band_s, ...
losses = unique(t.network_loss);
for k = 1:numel(losses)
  chosen = t.network_loss == losses(k);
  fprintf('loss %.1f: in the band after %.1f s (median of %d), least separation %.1f m, collisions %d\n', losses(k), ...
          median(t.in_band_s(chosen)), sum(chosen), min(t.min_separation_m(chosen)), sum(t.collisions(chosen)));
end

% plot(t.network_loss, t.in_band_s, 'o'); xlabel('loss'); ylabel('in the band after, s');
