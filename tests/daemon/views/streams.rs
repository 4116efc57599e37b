use super::{
    MIDDLE, WINDOW, World, boxed, camera, constant, held, hills, moved, next, through, through_window,
};
use crate::worlds::Random;
use std::time::Duration;
use terraquilt::client::view::{Opening, View};
use terraquilt::wire::v1;
use terraquilt::wire::v1::view_request::Kind;
use tonic::Code;

#[tokio::test]
async fn every_question_is_answered_and_commits_come_unasked() {
    let w = World::of(&[hills("a", [0.0, 0.0], 120, 4.0, 0)], |_| ()).await;
    let connection = w.connect().await;
    for follow in [false, true] {
        let mut view = View::open(&connection, Opening { follow, ..through_window() }).await.unwrap();
        let first = next(&mut view).await.unwrap();
        assert_eq!((first.from, first.answers, view.session.len()), (0, 1, 16));
        assert!(view.kept == w.server.state().views.kept && view.set.ground.is_some());
        assert_eq!(held(&view.set), w.answers(WINDOW, 1.0));
        let mut r = Random::new(7);
        for _ in 0..25 {
            let (b, error_m) = (moved(&mut r), [0.0, 0.7, 2.0, 9.0][r.below(4) as usize]);
            let asked = view.steer(Some(boxed(b)), constant(error_m)).await.unwrap();
            assert_eq!(next(&mut view).await.unwrap().answers, asked);
            assert_eq!(held(&view.set), w.answers(b, error_m));
        }
        // Nothing moves: an empty answer.
        let asked = view.steer(Some(boxed(WINDOW)), constant(1.0)).await.unwrap();
        assert_eq!(next(&mut view).await.unwrap().answers, asked);
        view.steer(Some(boxed(WINDOW)), constant(1.0)).await.unwrap();
        let same = next(&mut view).await.unwrap();
        assert!(same.added.is_empty() && same.removed.is_empty() && same.blocks == 0, "{same:?}");
        // A commit in the window.
        let name = format!("b{follow}");
        w.ingest(&hills(&name, [30.0, -30.0], 60, 1.0, 1));
        let told = next(&mut view).await.unwrap();
        assert!(told.answers == 0 && !told.added.is_empty() && told.blocks > 0, "{told:?}");
        assert_eq!(held(&view.set), w.answers(WINDOW, 1.0));
        w.remove(&name);
        assert!(!next(&mut view).await.unwrap().removed.is_empty());
        assert_eq!(held(&view.set), w.answers(WINDOW, 1.0));
    }
}

#[tokio::test]
async fn a_commit_elsewhere_is_not_told() {
    let w = World::of(&[hills("a", [0.0, 0.0], 120, 2.0, 0)], |_| ()).await;
    let mut view = View::open(&w.connect().await, through_window()).await.unwrap();
    next(&mut view).await.unwrap();
    let (version, bounds) = (view.set.version, view.set.ground.clone().unwrap().bounds);
    w.ingest(&hills("far", [20_000.0, 0.0], 60, 2.0, 0));
    let nothing = tokio::time::timeout(Duration::from_millis(400), view.next()).await;
    assert!(nothing.is_err(), "{nothing:?}");
    // The next difference is of the newer version, and says what else has changed.
    view.steer(Some(boxed(WINDOW)), constant(1.0)).await.unwrap();
    let told = next(&mut view).await.unwrap();
    assert!(told.added.is_empty() && told.removed.is_empty() && told.version > version, "{told:?}");
    assert_ne!(view.set.ground.unwrap().bounds, bounds);
}

#[tokio::test]
async fn where_nothing_is_the_set_is_empty_until_something_comes() {
    let w = World::of(&[], |_| ()).await;
    let mut view = View::open(&w.connect().await, through_window()).await.unwrap();
    let first = next(&mut view).await.unwrap();
    assert!(first.added.is_empty() && view.set.patches.is_empty() && first.version == 0, "{first:?}");
    let c = camera(MIDDLE, 50.0, 1.0);
    let asked = view.steer(None, through(c)).await.unwrap();
    assert_eq!(next(&mut view).await.unwrap().answers, asked);
    view.steer(Some(boxed(WINDOW)), constant(1.0)).await.unwrap();
    next(&mut view).await.unwrap();
    w.ingest(&hills("a", [0.0, 0.0], 120, 2.0, 0));
    let told = next(&mut view).await.unwrap();
    assert!(told.answers == 0 && !told.added.is_empty() && told.version == 1);
    assert_eq!(held(&view.set), w.answers(WINDOW, 1.0));
    assert!(view.set.patches.values().all(|p| !p.payload.is_empty()));
}

#[tokio::test]
async fn a_client_that_does_not_read_gets_few_large_steps() {
    let w = World::of(&[hills("a", [0.0, 0.0], 120, 4.0, 0)], |_| ()).await;
    let connection = w.connect().await;
    for (ahead, follow) in [(2, false), (2, true), (0, false)] {
        let opening = Opening { ahead, follow, ..through_window() };
        let mut view = View::open(&connection, opening).await.unwrap();
        next(&mut view).await.unwrap();
        let mut r = Random::new(u64::from(ahead) + 3);
        let mut last = (WINDOW, 1.0, 0);
        for k in 0..200 {
            let (b, error_m) = (moved(&mut r), [0.0, 0.7, 2.0][r.below(3) as usize]);
            last = (b, error_m, view.steer(Some(boxed(b)), constant(error_m)).await.unwrap());
            if k % 40 == 20 {
                w.ingest(&hills(
                    &format!("{ahead}{follow}{k}"),
                    [r.unit() * 200.0, -r.unit() * 200.0],
                    40,
                    1.0,
                    k,
                ));
            }
        }
        let mut read = 0;
        while next(&mut view).await.unwrap().answers < last.2 {
            read += 1;
        }
        assert!(ahead == 0 || read <= 4, "{read} differences for 200 questions");
        assert_eq!(held(&view.set), w.answers(last.0, last.1));
        // The same set, and the same hash, as one who asks now.
        let opening =
            Opening { region: Some(boxed(last.0)), tolerance: Some(constant(last.1)), ..Opening::default() };
        let mut fresh = View::open(&connection, opening).await.unwrap();
        next(&mut fresh).await.unwrap();
        assert_eq!(fresh.set.hash, view.set.hash);
        assert_eq!((&fresh.set.masks, &fresh.set.surveys), (&view.set.masks, &view.set.surveys));
    }
}

/// What a stream of requests ends with.
async fn ends_with(w: &World, requests: Vec<v1::ViewRequest>) -> tonic::Status {
    let n = requests.len();
    // The client's side stays open: what ends the stream is the server.
    let sent = futures_util::StreamExt::chain(
        tokio_stream::iter(requests),
        futures_util::stream::pending::<v1::ViewRequest>(),
    );
    let mut replies = match w.connect().await.view().hold(sent).await {
        Ok(replies) => replies.into_inner(),
        Err(status) => return status,
    };
    for _ in 0..n + 1 {
        let message = tokio::time::timeout(Duration::from_secs(60), replies.message()).await;
        if let Err(status) = message.expect("the server answers in time") {
            return status;
        }
    }
    panic!("the stream goes on")
}

fn asks(number: u64, region: Option<v1::Region>, tolerance: Option<v1::Tolerance>) -> v1::Question {
    v1::Question { number, region, tolerance }
}

fn opens(question: v1::Question) -> v1::ViewRequest {
    let open = v1::OpenView { question: Some(question), ..Default::default() };
    v1::ViewRequest { kind: Some(Kind::Open(open)), applied: 0 }
}

#[tokio::test]
async fn questions_that_are_none_are_refused_with_a_sentence() {
    let w = World::of(&[hills("a", [0.0, 0.0], 60, 2.0, 0)], |_| ()).await;
    let c = camera(MIDDLE, 50.0, 1.0);
    let inverted = boxed([WINDOW[2], WINDOW[1], WINDOW[0], WINDOW[3]]);
    let bad = [
        (asks(5, None, Some(through(v1::Camera { eye_x: f64::NAN, ..c }))), "finite"),
        (asks(5, None, Some(through(v1::Camera { viewport_width: 0, ..c }))), "empty"),
        (asks(5, None, Some(through(v1::Camera { fov_deg: 180.0, ..c }))), "180"),
        (asks(5, Some(inverted), Some(constant(1.0))), "empty"),
        (asks(5, Some(boxed([f64::NAN; 4])), Some(constant(1.0))), "finite"),
        (asks(5, None, Some(constant(-1.0))), "0 or more"),
        (asks(5, None, None), "missing"),
    ];
    let good = asks(1, None, Some(constant(1.0)));
    for (question, word) in bad {
        for requests in [
            vec![opens(question.clone())],
            vec![
                opens(good.clone()),
                v1::ViewRequest { kind: Some(Kind::Steer(question.clone())), applied: 0 },
            ],
        ] {
            let status = ends_with(&w, requests).await;
            assert_eq!(status.code(), Code::InvalidArgument, "{status}");
            assert!(status.message().contains(word), "{status}");
        }
    }
    let again = v1::ViewRequest { kind: Some(Kind::Steer(good.clone())), applied: 0 };
    let status = ends_with(&w, vec![opens(good.clone()), again.clone()]).await;
    assert!(status.code() == Code::InvalidArgument && status.message().contains("1 follows 1"), "{status}");
    assert_eq!(ends_with(&w, vec![again]).await.code(), Code::InvalidArgument);
    let status = ends_with(&w, vec![opens(good.clone()), opens(good.clone())]).await;
    assert!(status.code() == Code::InvalidArgument && status.message().contains("open already"), "{status}");
    let bent = v1::OpenView { question: Some(good.clone()), seams: 77, ..Default::default() };
    let bent = v1::ViewRequest { kind: Some(Kind::Open(bent)), applied: 0 };
    assert_eq!(ends_with(&w, vec![bent]).await.code(), Code::InvalidArgument);
    let unknown = v1::OpenView { question: Some(good.clone()), blend: 77, ..Default::default() };
    let unknown = v1::ViewRequest { kind: Some(Kind::Open(unknown)), applied: 0 };
    assert_eq!(ends_with(&w, vec![unknown]).await.code(), Code::InvalidArgument);
    // Steer refuses by itself, and its stream goes on.
    let connection = w.connect().await;
    let mut view = View::open(&connection, Opening { follow: true, ..through_window() }).await.unwrap();
    next(&mut view).await.unwrap();
    assert!(view.steer(None, through(v1::Camera { eye_z: f64::INFINITY, ..c })).await.is_err());
    let asked = view.steer(None, constant(2.0)).await.unwrap();
    assert_eq!(next(&mut view).await.unwrap().answers, asked);
    // After a bad question the session is still there.
    let mut view = View::open(&connection, through_window()).await.unwrap();
    next(&mut view).await.unwrap();
    view.steer(None, constant(f64::NAN)).await.unwrap();
    assert!(next(&mut view).await.unwrap_err().to_string().contains("NaN"));
    let mut view = view.resume(&connection, Some((None, constant(3.0)))).await.unwrap();
    let answer = next(&mut view).await.unwrap();
    assert_eq!((answer.from, answer.answers), (1, view.asked()));
}

#[tokio::test]
async fn a_view_that_is_too_large_is_refused() {
    let w = World::of(&[hills("a", [0.0, 0.0], 120, 2.0, 0)], |s| s.patches_max = 5).await;
    let status = ends_with(&w, vec![opens(asks(1, None, Some(constant(0.0))))]).await;
    assert!(status.code() == Code::ResourceExhausted && status.message().contains("at most 5"), "{status}");
}

#[tokio::test]
async fn a_server_that_stops_ends_its_views() {
    let w = World::of(&[hills("a", [0.0, 0.0], 60, 2.0, 0)], |_| ()).await;
    let mut view = View::open(&w.connect().await, through_window()).await.unwrap();
    next(&mut view).await.unwrap();
    let stopped =
        tokio::spawn(async move { tokio::time::timeout(Duration::from_secs(30), w.server.stop()).await });
    assert!(next(&mut view).await.unwrap_err().to_string().contains("stopping"));
    drop(view);
    stopped.await.unwrap().expect("the server stops in time").unwrap();
}
