//! The program to install on a node: its platform, the C library that it needs, and its name there.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::bundle::hex;
use skein_lab::error::Error;

/// A version of the GNU C library: major, minor.
pub type Glibc = (u32, u32);

/// The platform of a program for 64-bit Windows.
pub const WINDOWS: &str = "Windows x86_64";

/// A program file in memory.
#[derive(Clone, Debug)]
pub struct Program {
    /// Path of the file on this PC.
    pub path: PathBuf,
    /// Contents of the file.
    pub bytes: Arc<[u8]>,
    /// SHA-256, 64 hexadecimal digits.
    pub sum: String,
    /// Version and checksum, `0.1.0-1f2e3d4c5b6a`: the folder's name on a host.
    pub release: String,
    /// Its platform in the format of `uname -sm`, or [`WINDOWS`]; `None` if it is a program for neither Linux nor Windows.
    pub platform: Option<String>,
    /// The newest version of the C library that it needs, if any.
    pub glibc: Option<Glibc>,
}

impl Program {
    /// Reads a program file; without a path, that of this program.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn read(path: Option<&Path>) -> Result<Self, Error> {
        let path = match path {
            Some(path) => path.to_owned(),
            None => {
                std::env::current_exe().map_err(|error| Error::Failed(format!("this program's own file: {error}")))?
            }
        };
        let bytes = std::fs::read(&path).map_err(|error| Error::Refused(format!("{}: {error}", path.display())))?;
        Ok(Self::new(path, bytes))
    }

    fn new(path: PathBuf, bytes: Vec<u8>) -> Self {
        let digest = ring::digest::digest(&ring::digest::SHA256, &bytes);
        let sum = hex(digest.as_ref());
        let release = format!("{}-{}", env!("CARGO_PKG_VERSION"), &sum[..12]);
        let elf = Elf::open(&bytes);
        let linux = elf.as_ref().and_then(Elf::machine).map(|machine| format!("Linux {machine}"));
        let platform = linux.or_else(|| is_for_windows(&bytes).then(|| WINDOWS.to_owned()));
        let glibc = elf.as_ref().and_then(Elf::newest_glibc);
        Self { path, sum, release, platform, glibc, bytes: bytes.into() }
    }

    /// Checks that the program can run on a host with this platform and C library.
    ///
    /// # Errors
    /// If it cannot: one sentence with the remedy.
    pub fn fits(&self, platform: &str, glibc: Option<Glibc>) -> Result<(), String> {
        let path = self.path.display();
        match &self.platform {
            None => {
                return Err(format!("{path} is no program for {platform}; name one with `binary`"));
            }
            Some(own) if own != platform => {
                return Err(format!(
                    "is {platform}, but {path} is for {own}; name a program for its platform with `binary`"
                ));
            }
            Some(_) => {}
        }
        match (self.glibc, glibc) {
            (Some((major, minor)), None) => Err(format!(
                "has no GNU C library, but {path} needs {major}.{minor}; name another program with `binary`"
            )),
            (Some(required), Some(there)) if required > there => Err(format!(
                "has C library {}.{}, but {path} needs {}.{}; name a program built for an older version with `binary`",
                there.0, there.1, required.0, required.1
            )),
            _ => Ok(()),
        }
    }
}

/// Parses the output of `getconf GNU_LIBC_VERSION`: `glibc 2.36`.
pub fn glibc(text: &str) -> Option<Glibc> {
    version(text.trim().strip_prefix("glibc ")?)
}

fn version(text: &str) -> Option<Glibc> {
    let mut numbers = text.split('.').map(str::parse);
    Some((numbers.next()?.ok()?, numbers.next()?.ok()?))
}

/// Whether these are the bytes of a program for 64-bit Windows (PE): a header at the place that the old header names, for x86-64.
fn is_for_windows(bytes: &[u8]) -> bool {
    let at = bytes.get(0x3c..0x40).and_then(|at| Some(u32::from_le_bytes(at.try_into().ok()?) as usize));
    let header = at.and_then(|at| bytes.get(at..at.checked_add(6)?));
    bytes.starts_with(b"MZ") && header == Some(&[b'P', b'E', 0, 0, 0x64, 0x86])
}

/// Reads what is needed of a Linux executable (ELF): 64 bit, little-endian, like all computers that run X-Plane or an
/// agent.
struct Elf<'a>(&'a [u8]);

/// Type of the ELF section with the needed library versions.
const VERSIONS_NEEDED: u32 = 0x6fff_fffe;

impl<'a> Elf<'a> {
    fn open(bytes: &'a [u8]) -> Option<Self> {
        bytes.starts_with(b"\x7fELF\x02\x01").then_some(Self(bytes))
    }

    fn machine(&self) -> Option<&'static str> {
        match self.number::<2>(18)? {
            0x3e => Some("x86_64"),
            0xb7 => Some("aarch64"),
            0xf3 => Some("riscv64"),
            _ => None,
        }
    }

    fn number<const BYTES: usize>(&self, at: usize) -> Option<usize> {
        let bytes = self.0.get(at..at.checked_add(BYTES)?)?;
        Some(bytes.iter().rev().fold(0, |number, byte| number << 8 | usize::from(*byte)))
    }

    /// Position of the header of the nth section.
    fn section(&self, nth: usize) -> Option<usize> {
        let (first, size) = (self.number::<8>(0x28)?, self.number::<2>(0x3a)?);
        first.checked_add(nth.checked_mul(size)?)
    }

    /// The largest `GLIBC_x.y` among the versions needed.
    fn newest_glibc(&self) -> Option<Glibc> {
        let sections = self.number::<2>(0x3c)?;
        let needed = (0..sections).filter_map(|nth| self.section(nth));
        let needed = needed.into_iter().find(|at| self.number::<4>(at + 4) == Some(VERSIONS_NEEDED as usize))?;
        let (mut library, libraries) = (self.number::<8>(needed + 0x18)?, self.number::<4>(needed + 0x2c)?);
        let texts = self.number::<8>(self.section(self.number::<4>(needed + 0x28)?)? + 0x18)?;
        // Two chains, one within the other: the libraries, and the versions that are needed of each.
        let mut newest = None;
        for _ in 0..libraries {
            let mut required = library.checked_add(self.number::<4>(library + 8)?)?;
            for _ in 0..self.number::<2>(library + 2)? {
                let name = self.text(texts.checked_add(self.number::<4>(required + 8)?)?);
                newest = newest.max(name.and_then(|name| version(name.strip_prefix("GLIBC_")?)));
                required = required.checked_add(self.number::<4>(required + 12)?)?;
            }
            library = library.checked_add(self.number::<4>(library + 12)?)?;
        }
        newest
    }

    fn text(&self, at: usize) -> Option<&'a str> {
        let text = self.0.get(at..)?;
        std::str::from_utf8(&text[..text.iter().position(|byte| *byte == 0)?]).ok()
    }
}

#[cfg(test)]
mod tests {
    use std::ffi::OsStr;
    use std::process::Command;

    use super::*;

    fn program(platform: Option<&str>, glibc: Option<Glibc>) -> Program {
        let bytes: Arc<[u8]> = Arc::default();
        let platform = platform.map(str::to_owned);
        let (path, sum, release) = (PathBuf::from("skein-x"), String::new(), String::new());
        Program { path, bytes, sum, release, platform, glibc }
    }

    #[test]
    fn a_program_is_installed_only_where_it_can_run() {
        let linux = program(Some("Linux x86_64"), Some((2, 34)));
        let fits = |platform, glibc| linux.fits(platform, glibc);
        assert_eq!(fits("Linux x86_64", Some((2, 34))), Ok(()));
        assert_eq!(fits("Linux x86_64", Some((3, 0))), Ok(()));
        for (platform, glibc, why) in [
            ("Linux aarch64", Some((2, 40)), "is Linux aarch64, but skein-x is for Linux x86_64"),
            ("Darwin arm64", None, "is Darwin arm64, but skein-x is for Linux x86_64"),
            ("Linux x86_64", Some((2, 28)), "has C library 2.28, but skein-x needs 2.34"),
            ("Linux x86_64", None, "has no GNU C library, but skein-x needs 2.34"),
        ] {
            let message = fits(platform, glibc).unwrap_err();
            assert!(message.starts_with(why) && message.contains("`binary`"), "{message}");
        }
        assert_eq!(program(Some("Linux x86_64"), None).fits("Linux x86_64", None), Ok(()), "static");
        assert!(program(None, None).fits("Linux x86_64", None).is_err());
    }

    #[test]
    fn the_version_of_the_hosts_c_library_is_parsed() {
        assert_eq!(glibc("glibc 2.36\n"), Some((2, 36)));
        assert_eq!(glibc("glibc 2.9"), Some((2, 9)));
        assert_eq!(glibc(""), None);
        assert!(Some((2, 9)) < glibc("glibc 2.28"));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn this_very_program_runs_here() {
        let own = Program::read(None).unwrap();
        assert_eq!(own.platform.as_deref(), Some(format!("Linux {}", std::env::consts::ARCH).as_str()));
        assert_eq!(own.sum.len(), 64);
        assert_eq!(own.release, format!("{}-{}", env!("CARGO_PKG_VERSION"), &own.sum[..12]));
        let output_of = |program: &str, arguments: &[&OsStr]| {
            let output =
                Command::new(program).args(arguments).output().unwrap_or_else(|why| panic!("{program}: {why}"));
            String::from_utf8(output.stdout).unwrap()
        };
        let there = glibc(&output_of("getconf", &["GNU_LIBC_VERSION".as_ref()]));
        assert!(own.glibc.is_some() && own.glibc <= there, "{:?} {there:?}", own.glibc);
        // A PC that can link programs has readelf.
        let needs = output_of("readelf", &["--version-info".as_ref(), "--wide".as_ref(), own.path.as_ref()]);
        let names = needs.split("Name: GLIBC_").skip(1).filter_map(|rest| version(rest.split_whitespace().next()?));
        assert_eq!(own.glibc, names.max());
    }

    #[test]
    fn a_damaged_program_is_recognised_without_a_panic() {
        let own = Program::read(None).unwrap();
        for bytes in [&b""[..], b"\x7fELF", b"MZ\0\0", b"#!/bin/sh\n"] {
            assert_eq!(Program::new(PathBuf::new(), bytes.to_vec()).platform, None);
        }
        for length in [6, 19, 20, 0x3b, 64, 1000, own.bytes.len() / 2, own.bytes.len() - 1] {
            let _ = Program::new(PathBuf::new(), own.bytes[..length].to_vec());
        }
        let mut wild = own.bytes[..64].to_vec();
        wild[0x28..0x30].fill(0xff);
        wild[0x3a..0x40].fill(0xff);
        assert_eq!(Program::new(PathBuf::new(), wild).glibc, None);
    }
}
