//! Processes of a test and their processor times, from `/proc` of Linux. On other systems there are none.

use std::fs;

/// Ticks of the processor times in `/proc`, Hz: Linux shows every program 100, whatever the kernel counts in.
const PROC_HZ: f64 = 100.0;

/// The fields of `/proc/PID/stat` after the program's name, which may contain spaces.
fn stat(pid: u32) -> Option<Vec<String>> {
    let text = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    Some(text.rsplit_once(')')?.1.split_whitespace().map(str::to_owned).collect())
}

/// Processor time of a process, user and system, s; `None` if it has ended.
pub fn processor_time_s(pid: u32) -> Option<f64> {
    let stat = stat(pid)?;
    let ticks = |nth: usize| stat.get(nth)?.parse::<f64>().ok();
    Some((ticks(11)? + ticks(12)?) / PROC_HZ)
}

/// The processes that this process has started.
pub fn children_of(parent: u32) -> Vec<u32> {
    let processes = fs::read_dir("/proc").into_iter().flatten().flatten();
    let pids = processes.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    pids.filter(|&pid| stat(pid).is_some_and(|stat| stat.get(1).is_some_and(|of| *of == parent.to_string()))).collect()
}

/// What a process holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Resources {
    /// Memory that is present, MB.
    pub memory_mb: f64,
    /// Open file descriptors.
    pub descriptors: usize,
    /// Threads.
    pub threads: usize,
}

/// What a process holds; `None` if it has ended.
pub fn resources(pid: u32) -> Option<Resources> {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let number = |key: &str| -> Option<f64> {
        status.lines().find_map(|line| line.strip_prefix(key))?.split_whitespace().next()?.parse().ok()
    };
    Some(Resources {
        memory_mb: number("VmRSS:")? / 1024.0,
        descriptors: fs::read_dir(format!("/proc/{pid}/fd")).ok()?.count(),
        threads: number("Threads:")? as usize,
    })
}

/// The arguments with which a process was started, the program first; `None` if it has ended.
pub fn command_of(pid: u32) -> Option<Vec<String>> {
    let text = fs::read_to_string(format!("/proc/{pid}/cmdline")).ok()?;
    Some(text.split_terminator('\0').map(str::to_owned).collect())
}
