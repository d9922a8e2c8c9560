//! Servers that do not answer, or answer something else.

use wm_evaluation::judges::{Error, SuccessScore};

use super::{
    server::{Response, fails, says},
    setup::{Setup, entries},
};

#[test]
fn busy_server_sets_the_wait() {
    let setup = Setup::new(|n, _| match n {
        0 => fails(429, "Retry-After: 17\r\n"),
        1 => fails(503, "Retry-After: Sun, 06 Nov 1994 08:49:37 GMT\r\n"),
        _ => says("Final Score: 0"),
    });
    assert_eq!(setup.ask(0).unwrap(), Some(SuccessScore::Failure));
    assert_eq!(setup.clock.slept_s(), [17.0, 7.0]);
    assert_eq!(entries(&setup.path())[0]["answers"][0]["attempts"], 3);

    let setup = Setup::new(|_, _| fails(429, "Retry-After: 86400\r\n"));
    let error = setup.ask(0).unwrap_err();
    assert!(
        matches!(error, Error::WaitTooLong { wait_s: 86400, .. }),
        "{error}"
    );
    assert_eq!(setup.requests(), 1);
}

#[test]
fn failing_server_is_given_up() {
    let setup = Setup::new(|_, _| fails(500, ""));
    let error = setup.ask(0).unwrap_err();
    assert!(
        matches!(error, Error::GaveUp { attempts: 6, .. }),
        "{error}"
    );
    let text = error.to_string();
    assert!(
        text.contains("status 500: I am a test server and refuse.\\u{1b}[2J"),
        "{text}"
    );
    assert_eq!(setup.requests(), 6);
    let waits = [1.0, 2.0, 4.0, 8.0, 16.0];
    let slept = setup.clock.slept_s();
    assert_eq!(slept.len(), waits.len());
    for (slept, wait) in slept.into_iter().zip(waits) {
        assert!((wait / 2.0..=wait).contains(&slept), "{slept}");
    }
    assert!(entries(&setup.path()).is_empty());
}

#[test]
fn rejection_is_final() {
    for status in [307, 400, 401, 404] {
        let setup = Setup::new(move |_, _| fails(status, "Location: /elsewhere\r\n"));
        let error = setup.ask(0).unwrap_err();
        assert!(
            matches!(&error, Error::Rejected { status: s, .. } if *s == status),
            "{error}"
        );
        assert_eq!((setup.requests(), setup.clock.slept_s().len()), (1, 0));
    }
}

#[test]
fn broken_off_answer_is_retried() {
    let setup = Setup::new(|n, _| match n {
        // With a complete score in it, though the rest is unknown.
        0 => match says("Final Score: 0") {
            Response::Whole(_, _, body) => Response::BrokenOff(body),
            other => other,
        },
        _ => says("Final Score: 1"),
    });
    assert_eq!(setup.ask(0).unwrap(), Some(SuccessScore::Success));
    assert_eq!((setup.requests(), setup.clock.slept_s().len()), (2, 1));
}

#[test]
fn endless_answer_is_cut_off() {
    let setup = Setup::new(|_, _| Response::Endless);
    let error = setup.ask(0).unwrap_err();
    assert!(matches!(error, Error::BodyTooLarge { .. }), "{error}");
    assert_eq!(setup.requests(), 1);
}

#[test]
fn other_bodies_are_retried_and_unusable() {
    let garbage = "<html>I am a test server</html>".to_owned();
    let setup = Setup::new(move |_, _| Response::Whole(200, "", garbage.clone()));
    let error = setup.ask(0).unwrap_err().to_string();
    assert!(
        error.contains("after 6 attempts") && error.contains("<html>I am"),
        "{error}"
    );
    assert!(entries(&setup.path()).is_empty());
}

#[test]
fn server_that_hangs_up_is_given_up() {
    let setup = Setup::new(|_, _| Response::HangUp);
    let error = setup.ask(0).unwrap_err();
    assert!(
        matches!(error, Error::GaveUp { attempts: 6, .. }),
        "{error}"
    );
    assert_eq!(setup.requests(), 6);
}
