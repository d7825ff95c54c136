//! An agent's log on disk: a rotated series of files, the newest without a number, with a limited total size.

use std::collections::VecDeque;
use std::fs::{self, File};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::os;
use skein_host::clock;

/// Name of the newest file.
const FILE: &str = "agent.log";
/// Number of files.
const FILES: usize = 5;
/// Size limit of a file, bytes.
const MAX_BYTES: u64 = 1_000_000;
/// Length limit of a line, bytes; longer lines are cut.
const MAX_LINE_BYTES: u64 = 16_384;
/// Follows the time in a line that the supervisor wrote.
const OURS: &str = "  supervisor: ";
/// Interval at which a followed log is read.
const POLL_PERIOD: Duration = Duration::from_millis(100);

/// Path of the file of this age; 0 is the newest.
fn path(folder: &Path, age: usize) -> PathBuf {
    if age == 0 { folder.join(FILE) } else { folder.join(format!("{FILE}.{age}")) }
}

/// Writes the log. On a full disk lines are lost, and nothing else happens.
#[derive(Debug)]
pub(super) struct Log {
    folder: PathBuf,
    max_bytes: u64,
    file: Option<(File, u64)>,
}

impl Log {
    pub(super) fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), max_bytes: MAX_BYTES, file: None }
    }

    /// Adds a line, which includes its line end.
    pub(super) fn add(&mut self, line: &[u8]) {
        // After an error the file is opened again for the next line.
        self.file = self.try_add(line).ok();
    }

    /// Adds a line of the supervisor, with the time.
    pub(super) fn note(&mut self, what: &str) {
        self.add(format!("{}{OURS}{what}\n", clock::utc_stamp()).as_bytes());
    }

    fn try_add(&mut self, line: &[u8]) -> io::Result<(File, u64)> {
        let newest = path(&self.folder, 0);
        let (mut file, mut size) = match self.file.take() {
            Some(open) => open,
            None => open(&newest)?,
        };
        if size > 0 && size + line.len() as u64 > self.max_bytes {
            for age in (1..FILES).rev() {
                // A new log does not have all the files yet.
                let _ = fs::rename(path(&self.folder, age - 1), path(&self.folder, age));
            }
            (file, size) = open(&newest)?;
        }
        file.write_all(line)?;
        Ok((file, size + line.len() as u64))
    }
}

fn open(path: &Path) -> io::Result<(File, u64)> {
    let file = File::options().create(true).append(true).open(path)?;
    let size = file.metadata()?.len();
    Ok((file, size))
}

/// Whether the supervisor wrote this line, not the agent.
pub(super) fn is_ours(line: &str) -> bool {
    line.contains(OURS)
}

/// Reads lines to the end of the input and passes each to `give`.
pub(super) fn lines(input: impl Read, mut give: impl FnMut(&[u8])) {
    let mut input = BufReader::new(input);
    let mut line = Vec::new();
    while (&mut input).take(MAX_LINE_BYTES).read_until(b'\n', &mut line).is_ok_and(|size| size > 0) {
        if line.last() != Some(&b'\n') {
            line.push(b'\n');
        }
        give(&line);
        line.clear();
    }
}

/// Returns the last `count` lines, oldest first.
pub(super) fn tail(folder: &Path, count: usize) -> VecDeque<Vec<u8>> {
    let mut tail = VecDeque::new();
    for age in (0..FILES).rev() {
        if let Ok(file) = File::open(path(folder, age)) {
            lines(file, |line| {
                tail.push_back(line.to_vec());
                if tail.len() > count {
                    tail.pop_front();
                }
            });
        }
    }
    tail
}

/// Writes the last `count` lines, and then new lines until `is_over`.
pub(super) fn show(
    folder: &Path,
    count: usize,
    mut is_over: impl FnMut() -> bool,
    to: &mut impl Write,
) -> io::Result<()> {
    let newest = path(folder, 0);
    // Open the file before reading the tail: a line may be written twice then, but none is lost.
    let mut file = File::open(&newest).ok();
    if let Some(file) = &mut file {
        io::Seek::seek(file, io::SeekFrom::End(0))?;
    }
    for line in tail(folder, count) {
        to.write_all(&line)?;
    }
    to.flush()?;
    while !is_over() {
        if let Some(open) = &mut file {
            io::copy(open, to)?;
            to.flush()?;
        }
        let is_newest = file.as_ref().is_some_and(|file| os::is_file_at(file, &newest));
        if !is_newest {
            // Read to the end once more, because the last lines may have come before the file was renamed.
            file.as_mut().map_or(Ok(0), |open| io::copy(open, to))?;
            file = File::open(&newest).ok();
        }
        if is_newest || file.is_none() {
            clock::sleep(POLL_PERIOD);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::files;
    use super::*;

    fn sizes(folder: &Path) -> Vec<u64> {
        files::entries(folder).iter().filter_map(|path| Some(fs::metadata(path).ok()?.len())).collect()
    }

    fn text(line: &[u8]) -> String {
        String::from_utf8_lossy(line).trim_end().to_owned()
    }

    #[test]
    fn a_log_never_exceeds_its_size_limit() {
        let folder = tempfile::tempdir().unwrap();
        let mut log = Log { max_bytes: 100, ..Log::new(folder.path()) };
        for number in 0..100 {
            log.add(format!("line {number:4}\n").as_bytes());
        }
        // Each file has ten lines.
        assert_eq!(sizes(folder.path()), [100; FILES]);
        let all = tail(folder.path(), 1000);
        assert_eq!((all.len(), text(&all[0]), text(&all[49])), (50, "line   50".to_owned(), "line   99".to_owned()));
        assert_eq!(
            tail(folder.path(), 3).iter().map(|line| text(line)).collect::<Vec<_>>().concat(),
            "line   97line   98line   99"
        );
        // Another writer continues where this one has ended.
        Log { max_bytes: 100, ..Log::new(folder.path()) }.add(b"more\n");
        assert_eq!(text(&tail(folder.path(), 1)[0]), "more");
        assert_eq!(sizes(folder.path()).len(), FILES);
    }

    #[test]
    fn an_endless_line_is_cut() {
        let mut given = Vec::new();
        let endless = [b'x'; 2 * MAX_LINE_BYTES as usize + 5];
        lines(&endless[..], |line| given.push(line.len()));
        let whole = MAX_LINE_BYTES as usize + 1;
        assert_eq!(given, [whole, whole, 6]);
    }

    #[test]
    fn a_missing_folder_loses_lines_and_does_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let gone = folder.path().join("log");
        let mut log = Log::new(&gone);
        log.note("lost");
        fs::create_dir(&gone).unwrap();
        log.note("kept");
        let lines = tail(&gone, 9);
        assert_eq!(lines.len(), 1);
        assert!(text(&lines[0]).ends_with("Z  supervisor: kept"), "{:?}", text(&lines[0]));
    }
}
