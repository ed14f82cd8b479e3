use super::*;

#[test]
fn an_ambiguous_beginning_lists_the_sessions_that_match() {
    let ids = ["m20270116_1", "b20270115_2", "m20270115_1"];
    for (named, id) in [
        ("last", Some("m20270116_1")),
        ("b", Some("b20270115_2")),
        ("m20270115", Some("m20270115_1")),
        ("m20270116_1", Some("m20270116_1")),
        ("x", None),
    ] {
        assert_eq!(resolve_id(named, &ids).unwrap(), id, "{named}");
    }
    assert_eq!(resolve_id("m1", &["m11", "m1"]).unwrap(), Some("m1"));
    let refusal = resolve_id("m2027", &ids).unwrap_err();
    assert_eq!(refusal.code(), 2);
    assert!(
        refusal.to_string().contains("m20270116_1, m20270115_1;"),
        "{refusal}"
    );
}

#[test]
fn every_refusal_has_its_exit_code_and_a_remedy() {
    let text = || "so it is".to_owned();
    for (refusal, code, advice) in [
        (Fault::SessionActive(text()), 1, "tactus stop"),
        (Fault::NoSession(text()), 3, "tactus sessions"),
        (Fault::NoBaseline(text()), 3, "tactus baseline record"),
        (
            Fault::BaselineMismatch(text()),
            78,
            "tactus baseline record",
        ),
        (Fault::ModelMismatch(text()), 78, "--model one-step"),
        (Fault::InstrumentFault(text()), 5, "tactus instruments"),
        (Fault::NotAuthorized(text()), 4, "group tactus"),
        (Fault::LimitsExceeded(text()), 75, "try again"),
        (Fault::InvalidOption(text()), 2, "so it is"),
        (Fault::DiskRefused(text()), 1, "free space"),
        (Fault::NoFrame(text()), 1, "tactus watch"),
    ] {
        let failure = fault("it", &refusal);
        assert_eq!(failure.code(), code, "{refusal}");
        let message = failure.to_string();
        assert!(
            message.contains("so it is") && message.contains(advice),
            "{message}"
        );
    }
}

#[test]
fn errors_of_the_bus_itself_have_an_exit_code() {
    use zbus::fdo::Error;
    let code = |error: Error| {
        let failure = fault("it", &Fault::Connection(zbus::Error::FDO(Box::new(error))));
        assert!(failure.to_string().contains("so it is"), "{failure}");
        failure.code()
    };
    let text = || "so it is".to_owned();
    assert_eq!(code(Error::UnknownObject(text())), 3);
    assert_eq!(code(Error::UnknownMethod(text())), 3);
    assert_eq!(code(Error::ServiceUnknown(text())), 3);
    assert_eq!(code(Error::AccessDenied(text())), 4);
    assert_eq!(code(Error::LimitsExceeded(text())), 75);
    assert_eq!(code(Error::Failed(text())), 1);
}

#[test]
fn advice_is_not_given_twice() {
    let failure = fault(
        "it",
        &Fault::NoBaseline("run `tactus baseline record` first".into()),
    );
    assert_eq!(failure.to_string(), "run `tactus baseline record` first");
}

#[tokio::test]
async fn without_a_daemon_the_error_shows_how_to_start_one() {
    let folder = tempfile::tempdir().unwrap();
    let global = Global {
        bus: Some(format!("unix:{}/peer", folder.path().display())),
        state: None,
        #[cfg(feature = "archive")]
        archive_config: None,
        json: false,
        colour: crate::output::Colour::Never,
        timeout: Duration::from_secs(5),
    };
    let Err(failure) = open(&global).await else {
        panic!("nobody is there")
    };
    assert_eq!(failure.code(), 3);
    let message = failure.to_string();
    assert!(
        message.contains("/peer (nothing is there)\nStart one with `tactusd --config"),
        "{message}"
    );
    let wrong = Global {
        bus: Some("tcp:host".into()),
        ..global
    };
    let Err(failure) = open(&wrong).await else {
        panic!("no address")
    };
    assert_eq!(failure.code(), 2);
}
