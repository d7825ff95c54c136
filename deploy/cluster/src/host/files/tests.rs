use std::cell::Cell;

use super::*;

thread_local! {
    /// Number of changes that still succeed on this thread; the one after them fails.
    static CHANGES: Cell<u32> = const { Cell::new(u32::MAX) };
}

/// Lets this many changes succeed on this thread, and then none.
pub(in crate::host) fn fail_after(changes: u32) {
    CHANGES.set(changes);
}

pub(super) fn step() -> io::Result<()> {
    let left = CHANGES.get();
    CHANGES.set(left.saturating_sub(u32::from(left != u32::MAX)));
    if left == 0 { Err(io::Error::other("interrupted")) } else { Ok(()) }
}

#[test]
#[cfg(unix)]
fn a_link_is_replaced_even_if_a_draft_was_left_behind() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("current");
    fs::create_dir(draft(&path)).unwrap();
    for to in ["one", "two"] {
        link(&path, Path::new(to)).unwrap();
        assert_eq!(fs::read_link(&path).unwrap(), Path::new(to));
    }
    assert_eq!(entries(folder.path()), [path]);
}

#[test]
fn a_lock_has_one_holder_even_after_its_file_is_removed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lock");
    assert!(!Lock::is_held(&path) && !path.exists());
    let mut first = Lock::take(&path, Duration::ZERO).unwrap().unwrap();
    first.set_text("7").unwrap();
    assert!(Lock::is_held(&path) && Lock::take(&path, Duration::ZERO).unwrap().is_none());
    fs::remove_file(&path).unwrap();
    let second = Lock::take(&path, Duration::ZERO).unwrap().unwrap();
    assert!(os::is_file_at(&second.0, &path));
    drop(first);
    assert!(Lock::is_held(&path), "the second process holds it");
    drop(second);
    // A program that another test starts may have a copy of the lock's file for a moment.
    let until = clock::now() + Duration::from_secs(5);
    while Lock::is_held(&path) {
        assert!(clock::now() < until, "no process holds it any more");
        clock::sleep(POLL_PERIOD);
    }
}
