% Reads a CSV table of Skein in Matlab or Octave: a study's runs.csv, or trace.csv, peers.csv, laws.csv and events.csv, which
% `skein report RUN.mcap --csv` makes of a recording.
%
%   t = skein_table("my-study/runs.csv");
%   plot(t.network_loss, t.in_band_s, "o")
%
% The result is a struct with a field for each column, named like it with "_" for every other character: network.loss becomes
% network_loss. A column of numbers is a vector, with NaN where a cell is empty; any other column is a cell array of texts.
function t = skein_table(file)
  text = strrep(fileread(file), sprintf('\r'), '');
  lines = strsplit(text, sprintf('\n'), 'CollapseDelimiters', false);
  lines = lines(~cellfun(@isempty, lines));
  if any(text == '"')
    % A quoted cell may contain commas, and a quotation mark as two.
    rows = cellfun(@cells_of, lines, 'UniformOutput', false);
    cells = vertcat(rows{:});
  else
    cells = strsplit(strjoin(lines, ','), ',', 'CollapseDelimiters', false);
    cells = reshape(cells, [], numel(lines))';
  end
  t = struct();
  for column = 1:size(cells, 2)
    name = regexprep(cells{1, column}, '[^A-Za-z0-9_]', '_');
    values = cells(2:end, column);
    numbers = str2double(values);
    if all(isnan(numbers) <= cellfun(@isempty, values))
      values = numbers;
    end
    t.(name) = values;
  end
end

function cells = cells_of(line)
  tokens = regexp([',' line], ',("(?:[^"]|"")*"|[^,]*)', 'tokens');
  cells = cellfun(@(token) token{1}, tokens, 'UniformOutput', false);
  quoted = cellfun(@(cell) ~isempty(cell) && cell(1) == '"', cells);
  cells(quoted) = cellfun(@(cell) strrep(cell(2:end - 1), '""', '"'), cells(quoted), 'UniformOutput', false);
end
