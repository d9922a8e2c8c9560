use super::*;
use proptest::prelude::*;
use std::{collections::BTreeMap, convert::Infallible};
use wm_msgs::cdr;

/// Results and waiting clients are numbers.
type Numbers = Goals<u32, u32>;

fn id(number: u8) -> GoalId {
    GoalId([number; 16])
}

fn stamp(seconds: i32) -> Time {
    Time {
        sec: seconds,
        nanosec: 0,
    }
}

fn cancel(goals: &mut Numbers, id: Option<GoalId>, seconds: i32) -> (i8, Vec<GoalId>) {
    let goal_info = GoalInfo {
        goal_id: id.map(UUID::from).unwrap_or_default(),
        stamp: stamp(seconds),
    };
    let response = goals.cancel(&CancelGoalRequest { goal_info });
    let ids = response.goals_canceling.into_iter();
    let ids = ids.map(|info| info.goal_id.into()).collect();
    (response.return_code, ids)
}

fn end(goals: &mut Numbers, id: GoalId, end: End, now: Instant) -> Option<(u32, Vec<u32>)> {
    let result =
        |status: GoalStatus| Ok::<_, Infallible>(u32::from(status.number().unsigned_abs()));
    let Ok(ended) = goals.end(id, end, now, result);
    ended
}

/// Goals 1 to `number`, accepted at 1 s, 2 s, ...
fn accepted(number: u8, now: Instant) -> Numbers {
    let mut goals = Numbers::default();
    for each in 1..=number {
        goals.accept(id(each), stamp(each.into()), now).unwrap();
    }
    goals
}

/// Not the zero stamp, which would cancel all goals.
#[test]
fn a_request_to_cancel_with_an_invalid_time_is_not_decoded() {
    for (sec, nanosec) in [(-1, 1_000_000_000), (5, 1_000_000_000), (5, u32::MAX)] {
        let goal_info = GoalInfo {
            goal_id: UUID::default(),
            stamp: Time { sec, nanosec },
        };
        let bytes = cdr::to_bytes(&CancelGoalRequest { goal_info }).unwrap();
        let error = cdr::from_bytes::<CancelGoalRequest>(&bytes).unwrap_err();
        assert!(
            error.to_string().contains("expected less than 1e9 ns"),
            "{error}"
        );
    }
}

#[test]
fn a_goal_is_accepted_executed_and_ended() {
    let now = Instant::now();
    let mut goals = accepted(1, now);
    assert_eq!(goals.status(id(1)), Some(GoalStatus::Accepted));
    assert!(goals.execute(id(1)) && !goals.execute(id(1)));
    assert_eq!(goals.status(id(1)), Some(GoalStatus::Executing));
    assert_eq!(
        goals.ask(id(1), 7, now),
        Availability::Later { forgot: false }
    );
    assert_eq!(
        end(&mut goals, id(1), End::Succeeded, now),
        Some((4, vec![7]))
    );
    assert_eq!(goals.ask(id(1), 8, now), Availability::Ended(4));
    assert_eq!(end(&mut goals, id(1), End::Aborted, now), None);
    let [status] = goals.statuses().status_list[..] else {
        panic!("one goal")
    };
    assert_eq!(status.status, 4);
    assert_eq!(status.goal_info.stamp, stamp(1));
}

#[test]
fn what_cannot_be_made_a_result_leaves_the_goal_under_way() {
    let now = Instant::now();
    let mut goals = accepted(1, now);
    goals.ask(id(1), 7, now);
    let failed = goals.end(id(1), End::Succeeded, now, |_| Err("no"));
    assert_eq!(failed.unwrap_err(), "no");
    assert_eq!(goals.status(id(1)), Some(GoalStatus::Accepted));
    let ended = end(&mut goals, id(1), End::Aborted, now);
    assert_eq!(ended, Some((6, vec![7])));
}

#[test]
fn only_a_goal_that_was_to_be_canceled_ends_as_canceled() {
    let now = Instant::now();
    let mut goals = accepted(2, now);
    end(&mut goals, id(1), End::Canceled, now);
    assert_eq!(goals.status(id(1)), Some(GoalStatus::Aborted));
    assert_eq!(cancel(&mut goals, Some(id(2)), 0), (0, vec![id(2)]));
    assert!(!goals.execute(id(2)));
    end(&mut goals, id(2), End::Canceled, now);
    assert_eq!(goals.status(id(2)), Some(GoalStatus::Canceled));
}

/// The rules of `action_msgs/srv/CancelGoal`.
#[test]
fn goals_are_canceled_by_id_by_time_or_all() {
    let now = Instant::now();
    let (unknown, terminated) = (2, 3);
    let mut goals = accepted(4, now);
    assert_eq!(cancel(&mut goals, Some(id(9)), 0), (unknown, vec![]));
    assert_eq!(cancel(&mut goals, Some(id(3)), 0), (0, vec![id(3)]));
    assert_eq!(cancel(&mut goals, Some(id(3)), 0), (terminated, vec![]));
    // at that time or earlier, unless they are being canceled already
    assert_eq!(cancel(&mut goals, None, 2), (0, vec![id(1), id(2)]));
    assert_eq!(cancel(&mut goals, None, 3), (0, vec![]));
    assert_eq!(cancel(&mut goals, None, 0), (0, vec![id(4)]));

    let mut goals = accepted(4, now);
    end(&mut goals, id(1), End::Succeeded, now);
    assert_eq!(cancel(&mut goals, Some(id(1)), 0), (terminated, vec![]));
    let both = cancel(&mut goals, Some(id(4)), 2);
    assert_eq!(both, (0, vec![id(2), id(4)]));
}

#[test]
fn an_id_is_taken_once_and_goals_are_bounded() {
    let now = Instant::now();
    let most = u8::try_from(MOST_LIVE).unwrap();
    let mut goals = accepted(most, now);
    assert_eq!(goals.accept(id(1), stamp(9), now), Err(RejectReason::Known));
    assert_eq!(
        goals.accept(id(200), stamp(9), now),
        Err(RejectReason::Full)
    );
    end(&mut goals, id(1), End::Succeeded, now);
    assert_eq!(goals.accept(id(1), stamp(9), now), Err(RejectReason::Known));
    assert_eq!(goals.accept(id(200), stamp(9), now), Ok(()));
}

#[test]
fn results_are_kept_for_a_while_and_the_newest_of_many() {
    let start = Instant::now();
    let mut goals = accepted(2, start);
    end(&mut goals, id(1), End::Succeeded, start);
    let later = start + RESULT_TIMEOUT;
    let before = later - Duration::from_nanos(1);
    assert_eq!(goals.ask(id(1), 0, before), Availability::Ended(4));
    assert_eq!(goals.ask(id(1), 0, later), Availability::Unknown);
    // goals under way do not expire
    assert_eq!(
        goals.ask(id(2), 0, later),
        Availability::Later { forgot: false }
    );

    let mut goals = Numbers::default();
    let most = u8::try_from(MOST_ENDED).unwrap();
    for number in 1..=most + 3 {
        let now = start + Duration::from_millis(number.into());
        goals.accept(id(number), stamp(1), now).unwrap();
        end(&mut goals, id(number), End::Succeeded, now);
    }
    let known = |number| goals.status(id(number)).is_some();
    assert!(!known(1) && !known(3) && known(4) && known(most + 3));
}

#[test]
fn who_waits_for_a_result_is_bounded_too() {
    let now = Instant::now();
    let mut goals = accepted(1, now);
    let most = u32::try_from(MOST_WAITING).unwrap();
    for who in 0..=most {
        let forgot = who == most;
        assert_eq!(goals.ask(id(1), who, now), Availability::Later { forgot });
    }
    let (_, waiting) = end(&mut goals, id(1), End::Aborted, now).unwrap();
    assert_eq!(waiting, (1..=most).collect::<Vec<_>>());
}

#[derive(Clone, Debug)]
enum Event {
    Accept(u8),
    Execute(u8),
    Cancel(Option<u8>, i32),
    End(u8, End),
    Ask(u8),
}

fn event() -> impl Strategy<Value = Event> {
    let ends = prop_oneof![
        Just(End::Succeeded),
        Just(End::Canceled),
        Just(End::Aborted)
    ];
    let goal = 1u8..6;
    prop_oneof![
        goal.clone().prop_map(Event::Accept),
        goal.clone().prop_map(Event::Execute),
        (prop::option::of(goal.clone()), 0..6).prop_map(|(id, at)| Event::Cancel(id, at)),
        (goal.clone(), ends).prop_map(|(id, end)| Event::End(id, end)),
        goal.prop_map(Event::Ask),
    ]
}

/// The transitions of the design: from, to.
fn is_allowed(from: GoalStatus, to: GoalStatus) -> bool {
    use GoalStatus::{Aborted, Accepted, Canceled, Canceling, Executing, Succeeded};
    from == to
        || match from {
            // a goal may end at once: `execute` is then skipped
            Accepted => matches!(to, Executing | Canceling | Succeeded | Aborted),
            Executing => matches!(to, Canceling | Succeeded | Aborted),
            Canceling => matches!(to, Succeeded | Aborted | Canceled),
            Succeeded | Canceled | Aborted => false,
        }
}

proptest! {
    /// For any requests in any order: transitions are those of the design, each request for a result gets exactly one
    /// reply, and goals reported as canceling are canceling.
    #[test]
    fn goals_go_the_ways_of_the_design(events in prop::collection::vec(event(), 0..80)) {
        let now = Instant::now();
        let mut goals = Numbers::default();
        let (mut asked, mut answered) = (0u32, Vec::new());
        for (number, event) in events.into_iter().enumerate() {
            let before: BTreeMap<GoalId, GoalStatus> = (1..6)
                .filter_map(|goal| Some((id(goal), goals.status(id(goal))?)))
                .collect();
            match event {
                Event::Accept(goal) => {
                    let accepted = goals.accept(id(goal), stamp(goal.into()), now);
                    prop_assert_eq!(accepted.is_ok(), !before.contains_key(&id(goal)));
                }
                Event::Execute(goal) => {
                    goals.execute(id(goal));
                }
                Event::Cancel(goal, at) => {
                    let (code, canceling) = cancel(&mut goals, goal.map(id), at);
                    prop_assert!(code == 0 || canceling.is_empty());
                    for each in canceling {
                        prop_assert_eq!(goals.status(each), Some(GoalStatus::Canceling));
                        prop_assert_ne!(before[&each], GoalStatus::Canceling);
                    }
                }
                Event::End(goal, how) => {
                    if let Some((_, waiting)) = end(&mut goals, id(goal), how, now) {
                        answered.extend(waiting);
                    }
                    prop_assert!(goals.status(id(goal)).is_none_or(GoalStatus::is_end));
                }
                Event::Ask(goal) => {
                    let who = u32::try_from(number).unwrap();
                    asked += 1;
                    match goals.ask(id(goal), who, now) {
                        Availability::Later { .. } => {}
                        Availability::Ended(_) | Availability::Unknown => answered.push(who),
                    }
                }
            }
            for (goal, from) in &before {
                let to = goals.status(*goal);
                prop_assert!(to.is_some_and(|to| is_allowed(*from, to)), "{from} to {to:?}");
            }
        }
        for goal in 1..6 {
            let ended = end(&mut goals, id(goal), End::Aborted, now);
            answered.extend(ended.into_iter().flat_map(|(_, waiting)| waiting));
        }
        prop_assert_eq!(answered.len(), usize::try_from(asked).unwrap());
        answered.sort_unstable();
        answered.dedup();
        prop_assert_eq!(answered.len(), usize::try_from(asked).unwrap());
    }
}
