//! Runs independent tasks on several threads.

use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;

/// Runs `work` for 0 to `count` - 1, `jobs` at a time, and returns the results in order.
///
/// # Errors
/// The first error in this order. No task starts after one has failed.
pub fn in_parallel<T: Send, E: Send>(
    count: usize,
    jobs: NonZeroUsize,
    work: impl Fn(usize) -> Result<T, E> + Sync,
) -> Result<Vec<T>, E> {
    let next = AtomicUsize::new(0);
    let done = Mutex::new(Vec::with_capacity(count));
    thread::scope(|scope| {
        for _ in 0..jobs.get().min(count) {
            scope.spawn(|| {
                loop {
                    let nth = next.fetch_add(1, Ordering::Relaxed);
                    if nth >= count {
                        return;
                    }
                    let given = work(nth);
                    if given.is_err() {
                        // The remaining tasks are not needed.
                        next.store(count, Ordering::Relaxed);
                    }
                    done.lock().unwrap_or_else(PoisonError::into_inner).push((nth, given));
                }
            });
        }
    });
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_by_key(|(nth, _)| *nth);
    done.into_iter().map(|(_, given)| given).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const THREE: NonZeroUsize = NonZeroUsize::MIN.saturating_add(2);

    #[test]
    fn results_come_in_the_order_of_tasks() {
        let squares = in_parallel(100, THREE, |nth| Ok::<_, ()>(nth * nth)).unwrap();
        assert_eq!(squares, (0..100).map(|nth| nth * nth).collect::<Vec<_>>());
        assert_eq!(in_parallel(0, THREE, Err::<(), usize>), Ok(vec![]));
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
