use std::pin::pin;
use std::task::{Context, Waker};
use std::thread;

use super::*;
use crate::coe::object::ObjectAddress;
use crate::coe::sdo::{Step, Upload};
use crate::sii::{Mailbox, Protocols};

fn settings(request_capacity: usize) -> MailboxSettings {
    let mailbox = Mailbox {
        receive_offset: 0,
        receive_length: 64,
        send_offset: 0,
        send_length: 64,
        protocols: Protocols(4),
    };
    MailboxSettings {
        request_capacity,
        ..MailboxSettings::new(&mailbox)
    }
}

fn request(index: u16) -> Request {
    let object = ObjectAddress::new(index, 0);
    Request {
        transfer: Transfer::read(object),
        dialogue: Dialogue::Upload(Upload::new(object)),
        timeout: Duration::ZERO,
    }
}

/// Answers each call by the index that it asks for.
fn answer(served: &Served, call: Call) {
    let Call { request, place } = call;
    let [i0, i1] = request.transfer.object.index.to_le_bytes();
    let Dialogue::Upload(mut upload) = request.dialogue else {
        panic!("no upload");
    };
    let fed = upload.feed(&[0x4B, i0, i1, 0, i0, i1, 0, 0]);
    assert_eq!(fed, Ok(Step::Done));
    let dialogue = Dialogue::Upload(upload);
    let result = Ok(());
    served.answer(&place, Answer { dialogue, result });
}

#[test]
fn every_caller_gets_its_own_answer_and_every_place_is_given_back_though_callers_go_away() {
    const CALLS: u16 = 400;
    let (callers, served) = calls(settings(2), Waiters::direct());
    let callers = Arc::new(callers);
    let asked: Vec<_> = (0..6u16)
        .map(|thread| {
            let callers = Arc::clone(&callers);
            thread::spawn(move || {
                smol::block_on(async {
                    for number in 0..CALLS {
                        let index = thread << 12 | number;
                        let mut call = pin!(callers.call(request(index)));
                        if number % 3 == 1 {
                            // It goes away at some moment.
                            for _ in 0..number % 5 {
                                if smol::future::poll_once(call.as_mut()).await.is_some() {
                                    break;
                                }
                                thread::yield_now();
                            }
                            continue;
                        }
                        let answer = call.await.unwrap();
                        assert_eq!(answer.result, Ok(()));
                        assert_eq!(answer.dialogue.into_data(), index.to_le_bytes());
                    }
                });
            })
        })
        .collect();
    let client = thread::spawn(move || {
        smol::block_on(async {
            while let Some(call) = served.next().await {
                answer(&served, call);
            }
        });
    });
    for thread in asked {
        thread.join().unwrap();
    }
    let shared = Arc::clone(&callers.0);
    drop(callers);
    client.join().unwrap();
    assert_eq!(shared.free.1.len(), 3);
}

#[test]
fn what_a_caller_leaves_behind_is_no_answer_for_the_next() {
    let (callers, served) = calls(settings(1), Waiters::direct());
    let mut context = Context::from_waker(Waker::noop());
    for left in [1, 2] {
        {
            let mut call = pin!(callers.call(request(0x1000 + left)));
            assert!(call.as_mut().poll(&mut context).is_pending());
        }
        let call = smol::block_on(served.next()).unwrap();
        assert!(call.place.is_left());
        answer(&served, call);
    }
    for index in 0x2000..0x2004 {
        let mut call = pin!(callers.call(request(index)));
        assert!(call.as_mut().poll(&mut context).is_pending());
        answer(&served, smol::block_on(served.next()).unwrap());
        let Poll::Ready(Some(answer)) = call.as_mut().poll(&mut context) else {
            panic!("no answer");
        };
        assert_eq!(answer.dialogue.into_data(), index.to_le_bytes());
    }
    assert_eq!(callers.0.free.1.len(), 2);
}

#[test]
fn calls_that_wait_for_a_place_or_an_answer_end_with_the_client() {
    let (callers, served) = calls(settings(1), Waiters::direct());
    let callers = Arc::new(callers);
    let waiting: Vec<_> = (0..4)
        .map(|index| {
            let callers = Arc::clone(&callers);
            thread::spawn(move || smol::block_on(callers.call(request(index))).is_none())
        })
        .collect();
    while callers.0.waiting.len() < 2 {
        thread::yield_now();
    }
    drop(served);
    for thread in waiting {
        assert!(thread.join().unwrap());
    }
}

#[test]
fn the_client_serves_what_was_asked_and_ends_when_nobody_can_ask() {
    let (callers, served) = calls(settings(1), Waiters::direct());
    let mut context = Context::from_waker(Waker::noop());
    {
        let mut call = pin!(callers.call(request(1)));
        assert!(call.as_mut().poll(&mut context).is_pending());
    }
    drop(callers);
    assert!(smol::block_on(served.next()).is_some());
    assert!(smol::block_on(served.next()).is_none());
}
