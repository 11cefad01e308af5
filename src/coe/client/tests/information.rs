//! SDO information through the client.

use super::*;
use crate::coe::information::ListKind;
use crate::coe::mailbox::MailboxError;
use crate::coe::{ObjectAddress, TransferKind, TypeCode, Unsupported};

/// One fragment of an answer, behind the CoE header.
fn fragment(operation: u8, left: u16, data: &[u8]) -> Vec<u8> {
    let more = if left > 0 { 0x80 } else { 0 };
    let [l0, l1] = left.to_le_bytes();
    [&[operation | more, 0, l0, l1], data].concat()
}

fn whole(operation: u8, data: &[u8]) -> Vec<Vec<u8>> {
    vec![fragment(operation, 0, data)]
}

fn refused(code: u32) -> Vec<Vec<u8>> {
    whole(7, &code.to_le_bytes())
}

fn entry(index: u16, subindex: u8, name: &str) -> Vec<Vec<u8>> {
    let [i0, i1] = index.to_le_bytes();
    let head = [i0, i1, subindex, 7, 6, 0, 16, 0, 0x3F, 0];
    whole(6, &[&head[..], name.as_bytes()].concat())
}

/// Three fragments: 6040h, 1018h, 6041h, 6060h.
fn list() -> Vec<Vec<u8>> {
    vec![
        fragment(2, 2, &[1, 0, 0x40, 0x60]),
        fragment(2, 1, &[0x18, 0x10, 0x41]),
        fragment(2, 0, &[0x60, 0x60, 0x60]),
    ]
}

fn read_list(rig: &Rig, handle: &SdoHandle) -> Result<Vec<u16>, SdoError> {
    let handle = handle.clone();
    rig.run(async move { handle.object_list(ListKind::All).await })
        .map_err(|error| error.error)
}

const LIST: [u16; 4] = [0x6040, 0x1018, 0x6041, 0x6060];

#[test]
fn a_dictionary_is_read_with_what_the_drive_refuses_told_apart() {
    let (rig, device, handle, _) = rig();
    let variable = |index: u16, name: &[u8]| {
        let [i0, i1] = index.to_le_bytes();
        whole(4, &[&[i0, i1, 6, 0, 0, 7], name].concat())
    };
    device.0.borrow_mut().information = VecDeque::from([
        list(),
        variable(0x6040, b"Controlword"),
        entry(0x6040, 0, ""),
        // A record with a gap, and with an entry that is refused.
        whole(4, b"\x18\x10\x23\x00\x03\x09Identity"),
        entry(0x1018, 0, "Count"),
        refused(0x0609_0011),
        entry(0x1018, 2, "Product"),
        refused(0x0800_0000),
        refused(0x0800_0000),
        // An object that is listed and not there.
        refused(0x0602_0000),
        variable(0x6060, b"Mode"),
        // An entry that cannot be told with limits is asked for without them.
        refused(0x0607_0010),
        entry(0x6060, 0, "Mode"),
    ]);
    let asked = handle.clone();
    let dictionary = rig.run(async move { asked.dictionary().await }).unwrap();
    let indices = dictionary.objects.iter().map(|o| o.description.index);
    assert_eq!(indices.collect::<Vec<_>>(), [0x6040, 0x1018, 0x6060]);
    let identity: Vec<_> = dictionary.object(0x1018).unwrap().entries.iter().collect();
    let subindices = identity.iter().map(|entry| entry.address.subindex);
    assert_eq!(subindices.collect::<Vec<_>>(), [0, 2]);
    let told: Vec<_> = dictionary
        .undescribed
        .iter()
        .map(|lacking| (lacking.index, lacking.subindex, lacking.code.0))
        .collect();
    assert_eq!(
        told,
        [(0x1018, Some(3), 0x0800_0000), (0x6041, None, 0x0602_0000)]
    );
    let named: Vec<_> = dictionary.named("controlWORD").collect();
    assert_eq!(named[0].address, ObjectAddress::new(0x6040, 0));
    assert_eq!((named.len(), named[0].data_type), (1, TypeCode(6)));
    assert_eq!(dictionary.named("mode").count(), 1);
    assert!(device.0.borrow().information.is_empty());
}

#[test]
fn a_dictionary_that_does_not_end_is_given_up_at_its_bound() {
    let described = |name: &str| {
        VecDeque::from([
            whole(2, &[1, 0, 0x18, 0x10]),
            whole(4, b"\x18\x10\x23\x00\x01\x09Identity"),
            entry(0x1018, 0, name),
            refused(0x0800_0000),
            refused(0x0800_0000),
        ])
    };
    let (rig, device, handle, _) = rig();
    let mut needed = 0;
    for (more, name) in [(0, ""), (5, "Count")] {
        let taken = (0..1000).find(|most| {
            device.0.borrow_mut().information = described(name);
            let (asked, most) = (handle.clone(), *most);
            match rig.run(async move { asked.dictionary_within(most).await }) {
                Ok(dictionary) => !dictionary.objects.is_empty(),
                Err(DriveError { error, .. }) => {
                    let SdoError::WrongSize { expected, got, .. } = error else {
                        panic!("{error}")
                    };
                    assert_eq!(expected, most);
                    assert!(got > most);
                    false
                }
            }
        });
        let taken = taken.unwrap();
        assert!(
            taken > 150,
            "{taken}: an object, an entry, and one that is refused"
        );
        assert!(more == 0 || taken == needed + more, "a name counts");
        needed = taken;
    }
}

#[test]
fn a_device_without_the_service_says_so_and_goes_on() {
    let (rig, device, handle, _) = device_with_statusword();
    let reason = |rig: &Rig| match read_list(rig, &handle) {
        Err(SdoError::NotSupported { reason, transfer }) => {
            assert_eq!(transfer.kind, TransferKind::List(ListKind::All));
            reason
        }
        other => panic!("{other:?}"),
    };
    assert_eq!(reason(&rig), Unsupported::Mail(MailboxError(4)));
    device.0.borrow_mut().information = VecDeque::from([refused(0x0504_0001)]);
    assert_eq!(reason(&rig), Unsupported::Service(AbortCode::COMMAND));
    assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
    // By an SDO abort; a message before the one that would answer.
    let abort = vec![10, 0, 0, 0, 0, 0x33, 0, 0x20, 0x80, 0, 0, 0, 1, 0, 4, 5];
    device.post(&abort);
    device.0.borrow_mut().information = VecDeque::from([vec![]]);
    assert_eq!(reason(&rig), Unsupported::Service(AbortCode::COMMAND));
    assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
}

#[test]
fn a_device_whose_sii_has_no_sdo_information_is_not_asked() {
    let (rig, device, handle, _) = rig_with(|settings| settings.sdo_information = false);
    assert!(matches!(
        read_list(&rig, &handle),
        Err(SdoError::NotSupported {
            reason: Unsupported::Sii,
            ..
        })
    ));
    assert_eq!(device.0.borrow().accesses, 0);
    device.set(0x6041, 0, &[0x37, 0x16]);
    assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
}

#[test]
fn a_refusal_in_the_middle_of_a_list_ends_it_and_nothing_more() {
    let (rig, device, handle, _) = device_with_statusword();
    let broken = vec![list().swap_remove(0), refused(0x0800_0000).swap_remove(0)];
    device.0.borrow_mut().information = VecDeque::from([broken, list()]);
    let error = read_list(&rig, &handle).unwrap_err();
    assert_eq!(error.abort_code(), Some(AbortCode(0x0800_0000)));
    assert_eq!(read_list(&rig, &handle), Ok(LIST.to_vec()));
    assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
}

#[test]
fn a_fragment_that_the_device_leaves_out_is_an_error_and_the_next_list_is_whole() {
    for missing in [1, 2] {
        let (rig, device, handle, _) = device_with_statusword();
        let mut broken = list();
        broken.remove(missing);
        device.0.borrow_mut().information = VecDeque::from([broken, list()]);
        let error = read_list(&rig, &handle).unwrap_err();
        let step = SdoStep::Fragment;
        let expected = match missing {
            1 => matches!(
                error,
                SdoError::Fragments {
                    expected: 1,
                    got: 0,
                    ..
                }
            ),
            _ => matches!(error, SdoError::Timeout { step: s, .. } if s == step),
        };
        assert!(expected, "{error}");
        assert_eq!(read_list(&rig, &handle), Ok(LIST.to_vec()));
    }
}

#[test]
fn late_fragments_are_not_taken_for_those_of_the_next_list() {
    let (rig, device, handle, _) = rig();
    device.0.borrow_mut().information = VecDeque::from([list(), list()]);
    device.0.borrow_mut().delays = VecDeque::from([Duration::from_millis(1500)]);
    assert!(matches!(
        read_list(&rig, &handle),
        Err(SdoError::Timeout { .. })
    ));
    assert_eq!(read_list(&rig, &handle), Ok(LIST.to_vec()));
}

#[test]
fn any_single_lost_frame_leaves_a_list_whole_and_a_doubled_one_makes_no_other() {
    let run = |faults: VecDeque<Option<Fault>>| {
        let (rig, device, handle, _) = rig();
        device.0.borrow_mut().information = VecDeque::from([list()]);
        device.0.borrow_mut().faults = faults;
        (read_list(&rig, &handle), device.0.borrow().accesses)
    };
    let (_, accesses) = run(VecDeque::new());
    assert!(accesses > 5);
    for place in 0..accesses {
        for fault in [Fault::LostBefore, Fault::LostAfter, Fault::Twice] {
            let mut faults = VecDeque::from(vec![None; place]);
            faults.push_back(Some(fault));
            let (result, _) = run(faults);
            // A frame that is doubled on its way reads two fragments, of which one is gone for good: no list, then.
            let gone = fault == Fault::Twice && result.is_err();
            assert!(gone || result == Ok(LIST.to_vec()), "{fault:?} of {place}");
        }
    }
}

#[test]
fn emergencies_and_sdo_replies_between_the_fragments_do_no_harm() {
    let (rig, device, handle, emergencies) = rig();
    device.0.borrow_mut().information = VecDeque::from([vec![list().swap_remove(0)]]);
    // The rest of the list comes behind an emergency and a foreign SDO reply.
    let later = handle.clone();
    let mails = device.clone();
    let clock = rig.clock.clone();
    let result = rig.run(async move {
        let posting = async {
            clock.sleep_until(Duration::from_millis(5)).await;
            mails.post(&emergency(0x7320));
            mails.post(&[
                10, 0, 0, 0, 0, 0x63, 0, 0x30, 0x4B, 0x41, 0x60, 0, 1, 2, 0, 0,
            ]);
            for fragment in &list()[1..] {
                let length = (fragment.len() + 2) as u8;
                let mut mail = vec![length, 0, 0, 0, 0, 0x03, 0, 0x80];
                mail.extend(fragment);
                mails.post(&mail);
            }
        };
        smol::future::zip(later.object_list(ListKind::All), posting)
            .await
            .0
    });
    assert_eq!(result, Ok(LIST.to_vec()));
    assert_eq!(codes(&emergencies), [0x7320]);
}

proptest! {
    #[test]
    fn hostile_fragments_end_in_bounded_time_and_leave_the_mailbox_in_order(
        fragments in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..24), 0..6),
        headed in any::<bool>(),
    ) {
        let (rig, device, handle, _) = device_with_statusword();
        let hostile = fragments.into_iter().enumerate().map(|(at, mut body)| {
            if headed && body.len() > 6 {
                body[0] = 0x82;
                body[2..4].copy_from_slice(&(9 - at as u16).to_le_bytes());
            }
            body
        });
        device.0.borrow_mut().information = VecDeque::from([hostile.collect()]);
        let _ = read_list(&rig, &handle);
        prop_assert!(rig.clock.now() < Duration::from_secs(12));
        prop_assert_eq!(read_statusword(&rig, &handle), Ok(0x1637));
    }
}
