use super::*;

#[test]
fn an_ssh_that_does_not_know_a_setting_is_not_given_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ssh");
    std::fs::write(&path, "case \"$*\" in *SessionType*) exit 255;; esac\n").unwrap();
    let given = of_session(&["sh".into(), path.into()]);
    assert!(given.contains(&"RemoteCommand=none".to_owned()), "{given:?}");
    assert!(!given.iter().any(|option| NEWER[1].contains(&option.as_str())), "{given:?}");
    assert!(ALWAYS.iter().all(|setting| given.contains(&(*setting).to_owned())), "{given:?}");
}
