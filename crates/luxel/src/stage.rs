//! The stages of a session and the time each took.

use std::time::Instant;

/// One stage of the pipeline, in its order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Files into a scene.
    Read,
    /// Repair, contact lines, ray tree.
    Prepare,
    /// Surfaces into elements.
    Mesh,
    /// Direct light of the elements.
    Direct,
    /// Form factors, when they are stored.
    Factors,
    /// The radiosity equation.
    Solve,
    /// From elements to receivers.
    Gather,
    /// What was computed, held against what it should be.
    Measure,
    /// Files out.
    Write,
}

impl Stage {
    /// All stages, in order.
    pub const ALL: [Stage; 9] = [
        Stage::Read,
        Stage::Prepare,
        Stage::Mesh,
        Stage::Direct,
        Stage::Factors,
        Stage::Solve,
        Stage::Gather,
        Stage::Measure,
        Stage::Write,
    ];

    /// Name for people.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Read => "read",
            Stage::Prepare => "prepare",
            Stage::Mesh => "mesh",
            Stage::Direct => "direct light",
            Stage::Factors => "form factors",
            Stage::Solve => "solve",
            Stage::Gather => "gather",
            Stage::Measure => "measure",
            Stage::Write => "write",
        }
    }
}

/// Wall and processor seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seconds {
    /// By the clock on the wall.
    pub wall: f64,
    /// Processor time of the whole process, all cores; 0 where the system does not tell.
    pub cpu: f64,
}

/// Adds up the time of each stage.
#[derive(Clone, Debug)]
pub struct Clock {
    began: Instant,
    last: (Instant, f64),
    stages: [Seconds; Stage::ALL.len()],
}

impl Clock {
    /// Starts now.
    pub fn start() -> Clock {
        let now = Instant::now();
        Clock {
            began: now,
            last: (now, cpu_seconds()),
            stages: Default::default(),
        }
    }

    /// Books the time since the last call on `stage`.
    pub fn end(&mut self, stage: Stage) {
        let (now, cpu) = (Instant::now(), cpu_seconds());
        let seconds = &mut self.stages[stage as usize];
        seconds.wall += (now - self.last.0).as_secs_f64();
        seconds.cpu += cpu - self.last.1;
        self.last = (now, cpu);
    }

    /// Time of a stage so far.
    pub fn of(&self, stage: Stage) -> Seconds {
        self.stages[stage as usize]
    }

    /// Wall seconds since the start.
    pub fn elapsed_s(&self) -> f64 {
        self.began.elapsed().as_secs_f64()
    }
}

/// Processor seconds of this process so far, user and system; 0 where unknown.
pub fn cpu_seconds() -> f64 {
    #[cfg(unix)]
    {
        // SAFETY: getrusage fills the struct it is given and touches nothing else.
        unsafe {
            let mut usage: libc::rusage = std::mem::zeroed();
            if libc::getrusage(libc::RUSAGE_SELF, &mut usage) == 0 {
                let seconds = |t: libc::timeval| t.tv_sec as f64 + t.tv_usec as f64 * 1e-6;
                return seconds(usage.ru_utime) + seconds(usage.ru_stime);
            }
        }
    }
    0.0
}

/// Largest resident memory of this process so far, bytes; 0 where unknown.
pub fn peak_memory_bytes() -> u64 {
    // Asked first: getrusage on Linux counts the program that started this one as well.
    #[cfg(target_os = "linux")]
    if let Some(bytes) = std::fs::read_to_string("/proc/self/status")
        .ok()
        .and_then(|status| high_water_mark(&status))
    {
        return bytes;
    }
    #[cfg(unix)]
    {
        // SAFETY: as above.
        unsafe {
            let mut usage: libc::rusage = std::mem::zeroed();
            if libc::getrusage(libc::RUSAGE_SELF, &mut usage) == 0 {
                // Linux counts kilobytes, macOS bytes.
                let unit = if cfg!(target_os = "macos") { 1 } else { 1024 };
                return usage.ru_maxrss as u64 * unit;
            }
        }
    }
    0
}

/// `VmHWM:     5432 kB` in the status of a process, bytes.
#[cfg(target_os = "linux")]
fn high_water_mark(status: &str) -> Option<u64> {
    let mut words = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?
        .split_whitespace();
    let kilobytes: u64 = words.next()?.parse().ok()?;
    (words.next() == Some("kB")).then_some(1024 * kilobytes)
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn the_high_water_mark_is_found_and_rises() {
        assert_eq!(
            high_water_mark("Name:\tx\nVmHWM:\t    5432 kB\n"),
            Some(5_562_368)
        );
        assert_eq!(high_water_mark("Name:\tx\n"), None);
        let before = peak_memory_bytes();
        let block = vec![1_u8; before as usize + (32 << 20)];
        assert!(std::hint::black_box(&block).len() as u64 > before);
        assert!(peak_memory_bytes() >= before + (32 << 20));
    }
}
