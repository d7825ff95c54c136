//! Runs independent tasks on several threads.

use std::env;
use std::num::NonZeroUsize;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;

/// The number of cores that this process may use: those of its affinity, within the quota of its control group, and no more than
/// Slurm has given its task.
pub fn cores() -> NonZeroUsize {
    let available = thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
    within_task(available, env::var("SLURM_CPUS_PER_TASK").ok().as_deref())
}

fn within_task(available: NonZeroUsize, of_task: Option<&str>) -> NonZeroUsize {
    of_task.and_then(|cores| cores.parse().ok()).map_or(available, |cores| available.min(cores))
}

/// Runs `work` for 0 to `count` - 1, `jobs` at a time, and returns the results in order.
///
/// # Errors
/// The first error in this order. No task starts after one has failed.
pub fn in_parallel<T: Send, E: Send>(
    count: usize,
    jobs: NonZeroUsize,
    work: impl Fn(usize) -> Result<T, E> + Sync,
) -> Result<Vec<T>, E> {
    in_parallel_by(count, jobs, |tasks| {
        while let Some(nth) = tasks.take() {
            tasks.finish(nth, work(nth));
        }
    })
}

/// Runs `worker` in up to `jobs` threads, each of which takes tasks 0 to `count` - 1 and finishes them, possibly several
/// at a time. Returns the results in the order of tasks.
///
/// # Errors
/// The first error in this order. No task is given out after one has failed.
pub fn in_parallel_by<T: Send, E: Send>(
    count: usize,
    jobs: NonZeroUsize,
    worker: impl Fn(&Tasks<T, E>) + Sync,
) -> Result<Vec<T>, E> {
    let tasks = Tasks { count, next: AtomicUsize::new(0), done: Mutex::new(Vec::with_capacity(count)) };
    thread::scope(|scope| {
        for _ in 0..jobs.get().min(count) {
            scope.spawn(|| worker(&tasks));
        }
    });
    let mut done = tasks.done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_by_key(|(nth, _)| *nth);
    done.into_iter().map(|(_, result)| result).collect()
}

/// The tasks of [`in_parallel_by`].
#[derive(Debug)]
pub struct Tasks<T, E> {
    count: usize,
    next: AtomicUsize,
    done: Mutex<Vec<(usize, Result<T, E>)>>,
}

impl<T, E> Tasks<T, E> {
    /// Takes the next task; `None` after the last, or after one has failed.
    pub fn take(&self) -> Option<usize> {
        let nth = self.next.fetch_add(1, Ordering::Relaxed);
        (nth < self.count).then_some(nth)
    }

    /// Finishes a task that was taken.
    pub fn finish(&self, nth: usize, result: Result<T, E>) {
        if result.is_err() {
            // The remaining tasks are not needed.
            self.next.store(self.count, Ordering::Relaxed);
        }
        self.done.lock().unwrap_or_else(PoisonError::into_inner).push((nth, result));
    }
}

/// Runs these tasks at the same time, the first in this thread and each other one in a thread of its own, and returns
/// their results in order.
pub fn at_once<T: Send>(tasks: impl IntoIterator<Item = impl FnOnce() -> T + Send>) -> Vec<T> {
    let mut tasks = tasks.into_iter();
    let Some(first) = tasks.next() else { return Vec::new() };
    thread::scope(|scope| {
        let others: Vec<_> = tasks.map(|task| scope.spawn(task)).collect();
        let mut results = vec![first()];
        results.extend(others.into_iter().map(|other| other.join().unwrap_or_else(|panic| resume_unwind(panic))));
        results
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const THREE: NonZeroUsize = NonZeroUsize::MIN.saturating_add(2);

    #[test]
    fn a_task_of_slurm_takes_no_more_cores_than_it_was_given() {
        let two = NonZeroUsize::MIN.saturating_add(1);
        for (of_task, cores) in
            [(None, THREE), (Some("2"), two), (Some("64"), THREE), (Some("0"), THREE), (Some(""), THREE)]
        {
            assert_eq!(within_task(THREE, of_task), cores, "{of_task:?}");
        }
    }

    #[test]
    fn results_come_in_the_order_of_tasks() {
        let squares = in_parallel(100, THREE, |nth| Ok::<_, ()>(nth * nth)).unwrap();
        assert_eq!(squares, (0..100).map(|nth| nth * nth).collect::<Vec<_>>());
        assert_eq!(in_parallel(0, THREE, Err::<(), usize>), Ok(vec![]));
    }

    #[test]
    fn tasks_at_once_change_their_own_share_and_give_their_results_in_order() {
        let mut numbers: Vec<usize> = (0..10).collect();
        let tasks = numbers.chunks_mut(3).map(|share| {
            move || {
                share.iter_mut().for_each(|number| *number *= 2);
                share[0]
            }
        });
        assert_eq!(at_once(tasks), [0, 6, 12, 18]);
        assert_eq!(numbers, (0..10).map(|number| 2 * number).collect::<Vec<_>>());
        assert_eq!(at_once(Vec::<fn()>::new()), []);
    }

    #[test]
    fn no_task_starts_after_a_failure() {
        let begun = AtomicUsize::new(0);
        let failed = in_parallel(10_000, THREE, |nth| {
            begun.fetch_add(1, Ordering::Relaxed);
            if nth == 5 { Err(nth) } else { Ok(()) }
        });
        assert_eq!(failed, Err(5));
        assert!(begun.into_inner() < 10_000);
    }
}
