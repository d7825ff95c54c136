% Values of Octave's fuzzy-logic-toolkit for each system in tests/golden/sugeno, as the text of tests/golden/sugeno.csv.
% Run in that folder: octave-cli --quiet ../../src/sugeno.m > ../sugeno.csv
pkg load fuzzy-logic-toolkit
steps = @(range) range(1) + (range(2) - range(1)) * [0 0.04 0.13 0.21 0.3 0.39 0.47 0.5 0.56 0.64 0.73 0.81 0.9 0.97 1];
printf("file,output,x1,x2,value\n");
files = sort(glob("*.fis"));
for i = 1:numel(files)
  fis = readfis(files{i});
  first = steps(fis.input(1).range);
  second = 0;
  if numel(fis.input) > 1
    second = steps(fis.input(2).range);
  end
  for x1 = first
    for x2 = second
      x = [x1 x2](1:numel(fis.input));
      values = evalfis(x, fis);
      for output = 1:numel(values)
        printf("%s,%d,%.17g,%.17g,%.17g\n", files{i}, output, x1, x2, values(output));
      end
    end
  end
end
