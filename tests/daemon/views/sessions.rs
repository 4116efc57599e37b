use super::{WINDOW, World, boxed, constant, held, hills, moved, next, through_window};
use crate::worlds::Random;
use std::time::Duration;
use terraquilt::client::view::{Opening, View};
use terraquilt::wire::v1;
use tonic::Code;

#[tokio::test]
async fn broken_connections_go_on_where_they_were() {
    let w = World::of(&[hills("a", [0.0, 0.0], 120, 4.0, 0)], |_| ()).await;
    for follow in [false, true] {
        let mut r = Random::new(11);
        let opening = Opening { follow, ..through_window() };
        let mut view = View::open(&w.connect().await, opening).await.unwrap();
        next(&mut view).await.unwrap();
        let (mut asked, mut lost, mut there) = ((WINDOW, 1.0), 0, false);
        for round in 0..30 {
            // Some differences are read, some are lost on the way.
            for _ in 0..r.below(4) {
                asked = (moved(&mut r), [0.0, 0.7, 2.0][r.below(3) as usize]);
                view.steer(Some(boxed(asked.0)), constant(asked.1)).await.unwrap();
                if r.chance(0.6) {
                    next(&mut view).await.unwrap();
                }
            }
            if r.chance(0.3) {
                // Something comes or leaves while nobody is connected, or just before.
                match there {
                    false => w.ingest(&hills("b", [30.0, -30.0], 80, 1.0, 1)),
                    true => w.remove("b"),
                }
                there = !there;
            }
            let before = (view.set.number, view.session.clone());
            let to = r.chance(0.5).then(|| (moved(&mut r), 0.7));
            asked = to.unwrap_or(asked);
            let again = to.map(|(b, e)| (Some(boxed(b)), constant(e)));
            // A new connection each time; the old one goes with the old view.
            view = view.resume(&w.connect().await, again).await.unwrap();
            let first = next(&mut view).await.unwrap();
            assert_eq!((first.from, &view.session), (before.0, &before.1), "round {round}");
            lost += usize::from(first.to > before.0 + 1);
            assert_eq!(first.answers, view.asked());
            assert_eq!(held(&view.set), w.answers(asked.0, asked.1));
        }
        assert!(lost > 3, "{lost} times something was lost on the way");
        if there {
            w.remove("b");
        }
    }
}

#[tokio::test]
async fn a_newer_stream_takes_over() {
    let w = World::of(&[hills("a", [0.0, 0.0], 80, 2.0, 0)], |_| ()).await;
    let connection = w.connect().await;
    let mut first = View::open(&connection, through_window()).await.unwrap();
    next(&mut first).await.unwrap();
    let open = v1::OpenView {
        resume: Some(v1::Resume {
            session: first.session.clone(),
            applied: first.set.number,
            hash: first.set.hash.clone(),
        }),
        ..Default::default()
    };
    let mut second = connection.view().follow(open).await.unwrap().into_inner();
    let told = second.message().await.unwrap().unwrap();
    assert_eq!((told.from, told.answers, &told.session), (1, 1, &first.session));
    assert!(next(&mut first).await.unwrap_err().to_string().contains("taken this view over"));
    // The older stream steers no more; the newer goes on.
    let _ = first.steer(None, constant(9.0)).await;
    let steer = v1::SteerRequest {
        session: first.session.clone(),
        question: Some(v1::Question { number: 9, region: None, tolerance: Some(constant(2.0)) }),
        applied: 0,
    };
    assert_eq!(connection.view().steer(steer.clone()).await.unwrap().into_inner().number, 9);
    assert_eq!(second.message().await.unwrap().unwrap().answers, 9);
    // An older question comes late: the newer one goes on being answered.
    let late = v1::Question { number: 4, ..steer.question.clone().unwrap() };
    let late = v1::SteerRequest { question: Some(late), ..steer };
    assert_eq!(connection.view().steer(late).await.unwrap().into_inner().number, 9);
}

#[tokio::test]
async fn what_the_server_does_not_remember_starts_anew() {
    let w = World::of(&[hills("a", [0.0, 0.0], 80, 2.0, 0)], |s| {
        s.sessions_kept = Duration::from_millis(300);
    })
    .await;
    let connection = w.connect().await;
    let mut view = View::open(&connection, through_window()).await.unwrap();
    next(&mut view).await.unwrap();
    // A wrong hash: the same session, from the start.
    let (session, asked) = (view.session.clone(), view.asked());
    view.set.hash = bytes::Bytes::from_static(&[7; 16]);
    let mut view = view.resume(&connection, None).await.unwrap();
    let told = next(&mut view).await.unwrap();
    assert_eq!((told.from, told.answers, &view.session), (0, asked, &session));
    assert_eq!(held(&view.set), w.answers(WINDOW, 1.0));
    // Expired: another session.
    let lost = view.resume(&connection, Some((Some(boxed(WINDOW)), constant(1.0)))).await.unwrap();
    drop(lost);
    tokio::time::sleep(Duration::from_millis(900)).await;
    assert_eq!(w.server.state().views.count(), 0, "sessions are swept");
    let resume = v1::Resume { session: session.clone(), applied: 1, hash: bytes::Bytes::new() };
    let open = v1::OpenView { resume: Some(resume), ..Default::default() };
    let refused = connection.view().follow(open.clone()).await.unwrap_err();
    assert_eq!(refused.code(), Code::NotFound, "{refused}");
    let question = v1::Question { number: 3, region: None, tolerance: Some(constant(1.0)) };
    let open = v1::OpenView { question: Some(question.clone()), ..open };
    let mut replies = connection.view().follow(open).await.unwrap().into_inner();
    let told = replies.message().await.unwrap().unwrap();
    assert!(told.from == 0 && told.answers == 3 && told.session != session);
    let steer = v1::SteerRequest { session, question: Some(question), applied: 0 };
    let refused = connection.view().steer(steer).await.unwrap_err();
    assert_eq!(refused.code(), Code::NotFound, "{refused}");
}

#[tokio::test]
async fn a_version_that_is_pruned_leaves_views_in_step() {
    let w = World::of(&[hills("a", [0.0, 0.0], 80, 2.0, 0)], |_| ()).await;
    let connection = w.connect().await;
    let mut view = View::open(&connection, through_window()).await.unwrap();
    next(&mut view).await.unwrap();
    let session = view.session.clone();
    // The stream breaks; the survey goes, and every version that had it.
    let old = view.set.clone();
    w.remove("a");
    let db = &w.scratch.db;
    let gone = db.prune(|all| all.to_vec(), &mut || ()).unwrap();
    assert!(!gone.pruned.is_empty(), "the version is gone: {gone:?}");
    let mut view = view.resume(&connection, None).await.unwrap();
    let told = next(&mut view).await.unwrap();
    assert_eq!((told.from, told.removed.len()), (old.number, old.patches.len()));
    assert!(view.set.patches.is_empty() && view.set.masks.is_empty() && view.set.surveys.is_empty());
    assert_eq!(view.session, session);
}

#[tokio::test]
async fn too_many_views_make_room_or_are_refused() {
    let w = World::of(&[hills("a", [0.0, 0.0], 60, 2.0, 0)], |s| s.sessions_max = 3).await;
    let connection = w.connect().await;
    let mut views = Vec::new();
    for _ in 0..3 {
        let mut view = View::open(&connection, through_window()).await.unwrap();
        next(&mut view).await.unwrap();
        views.push(view);
    }
    let refused = View::open(&connection, through_window()).await.err().expect("three are open").to_string();
    assert!(refused.contains("4 wanted, at most 3"), "{refused}");
    // One whose stream ended makes room.
    drop(views.remove(0));
    for _ in 0..100 {
        tokio::time::sleep(Duration::from_millis(20)).await;
        if let Ok(mut view) = View::open(&connection, through_window()).await {
            next(&mut view).await.unwrap();
            assert_eq!(w.server.state().views.count(), 3);
            return;
        }
    }
    panic!("no room was made");
}
