//! SDO information of simulated drives that have it, and of one that has not.

use servocrab::coe::information::{ListKind, ObjectCode};
use servocrab::coe::{
    AnyObject, DriveError, NoInformation, ObjectAddress, SdoError, TypeCode, obj,
};
use servocrab_sim::personality::{self, Servo};

use crate::{with_device, with_settings};

#[test]
fn the_dictionary_of_a_drive_is_read_whole_and_agrees_with_the_librarys_objects() {
    with_device(personality::generic(), async |_, handle, _| {
        let dictionary = handle.dictionary().await?;
        assert!(
            dictionary.undescribed.is_empty(),
            "{:?}",
            dictionary.undescribed
        );
        assert!(dictionary.entries().count() > 100);
        let counts = handle.object_counts().await?;
        assert_eq!(usize::from(counts.all), dictionary.objects.len());

        // What the library knows of the objects, the drive tells likewise.
        let mut compared = 0;
        for known in obj::all() {
            let Some(entry) = dictionary.entry(known.address()) else {
                continue;
            };
            assert_eq!(Some(entry.data_type), code_of(&known), "{}", known.name);
            assert!(entry.access.readable(), "{}", known.name);
            compared += 1;
        }
        assert!(compared > 60, "{compared} compared");

        let target = dictionary.entry(ObjectAddress::new(0x607A, 0)).unwrap();
        assert!(target.access.mappable().outputs && target.access.writable_in_op());
        assert_eq!(target.bits, 32);
        let statusword = dictionary.object(0x6041).unwrap();
        assert_eq!(statusword.description.code, ObjectCode::Variable);
        assert_eq!(statusword.description.name, "Statusword");
        assert!(!statusword.entries[0].access.writable());
        let named: Vec<_> = dictionary.named("statusWORD").collect();
        assert_eq!(named[0].address, obj::STATUSWORD.address());
        let velocity = dictionary.entry(obj::PROFILE_VELOCITY.address()).unwrap();
        assert!(velocity.unit.is_some() && velocity.minimum.is_some());
        let default = velocity.default.as_deref().unwrap();
        let now = handle.read(obj::PROFILE_VELOCITY).await?;
        assert_eq!(velocity.data_type.show(default), now.to_string());
        Ok::<_, DriveError>(())
    })
    .unwrap();
}

/// The number of the library's type.
fn code_of(object: &AnyObject) -> Option<TypeCode> {
    Some(object.data_type.into())
}

#[test]
fn lists_by_kind_are_parts_of_the_list_of_all() {
    // Mailboxes of 48 bytes: the lists come in fragments.
    let device = Servo::generic().mailbox_bytes(48).build();
    with_device(device, async |_, handle, _| {
        let all = handle.object_list(ListKind::All).await?;
        let counts = handle.object_counts().await?;
        let outputs = handle.object_list(ListKind::Outputs).await?;
        let inputs = handle.object_list(ListKind::Inputs).await?;
        assert_eq!(usize::from(counts.outputs), outputs.len());
        assert_eq!(usize::from(counts.inputs), inputs.len());
        assert!(outputs.contains(&0x607A) && !outputs.contains(&0x1018));
        assert!(inputs.contains(&0x6041) && !inputs.contains(&0x1018));
        assert!(outputs.iter().chain(&inputs).all(|one| all.contains(one)));
        assert!(all.len() > outputs.len());
        Ok::<_, DriveError>(())
    })
    .unwrap();
}

#[test]
fn what_is_not_there_is_an_abort_of_that_question() {
    with_device(personality::generic(), async |_, handle, _| {
        let error = handle.describe_object(0x5555).await.unwrap_err().error;
        assert!(error.abort_code().is_some(), "{error}");
        let text = error.to_string();
        assert!(text.starts_with("asking what 5555h is: "), "{text}");
        let error = handle.describe_entry(0x1018, 9).await.unwrap_err().error;
        assert!(error.abort_code().is_some(), "{error}");
        let text = error.to_string();
        assert!(text.starts_with("asking what 1018h:09 is: "), "{text}");
    });
}

#[test]
fn a_drive_without_the_service_says_so_whether_its_sii_tells_it_or_not() {
    for asked in [true, false] {
        with_settings(
            personality::akd2g(),
            |settings| settings.sdo_information = asked,
            async |_, handle, _| {
                let error = handle.dictionary().await.unwrap_err().error;
                let SdoError::NotSupported { reason, .. } = &error else {
                    panic!("{error}");
                };
                assert_eq!(*reason == NoInformation::Sii, !asked, "{error}");
                assert!(handle.read(obj::VENDOR_ID).await.is_ok());
            },
        );
    }
}

#[test]
fn the_dictionary_of_every_drive_is_read_as_the_drive_has_it() {
    for servo in [
        Servo::akd2g(),
        Servo::pp2010(),
        Servo::ax2000(),
        Servo::sigma7(),
        Servo::generic(),
    ] {
        // Lists and most descriptions come in fragments.
        let mut device = servo.with_sdo_information().mailbox_bytes(40).build();
        let has = device.dictionary();
        with_device(device, async |_, handle, _| {
            let read = handle.dictionary().await?;
            assert!(read.undescribed.is_empty(), "{:?}", read.undescribed);
            assert_eq!(read.objects.len(), has.len());
            for (read, has) in read.objects.iter().zip(&has) {
                let object = &read.description;
                assert_eq!(
                    (object.index, &object.name, object.max_subindex),
                    (has.index, &has.name, has.last)
                );
                assert_eq!(object.data_type, TypeCode(has.data_type), "{}", has.name);
                assert_eq!(object.code, ObjectCode::from(has.code), "{}", has.name);
                assert_eq!(read.entries.len(), has.entries.len(), "{}", has.name);
                for (read, entry) in read.entries.iter().zip(&has.entries) {
                    assert_eq!(read.address, ObjectAddress::new(has.index, entry.subindex));
                    assert_eq!(
                        read.data_type,
                        TypeCode(entry.data_type),
                        "{}",
                        read.address
                    );
                    assert_eq!(
                        (read.bits, read.access.0, &read.name, read.unit),
                        (entry.bits, entry.access, &entry.name, entry.unit),
                        "{}",
                        read.address
                    );
                    let (minimum, maximum) = entry.range.clone().unzip();
                    // A text shorter than it may be leaves open where its default ends: it is asked for without.
                    let default = entry.default.clone();
                    let default =
                        default.filter(|value| 8 * value.len() == usize::from(entry.bits));
                    assert_eq!(read.default, default, "{}", read.address);
                    assert_eq!((&read.minimum, &read.maximum), (&minimum, &maximum));
                }
            }
            Ok::<_, DriveError>(())
        })
        .unwrap();
    }
}
