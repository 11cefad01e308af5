//! What the system says about a network interface.

use std::path::Path;

use ethtool::{EthtoolAttr, EthtoolCoalesceAttr, EthtoolError, EthtoolFeatureAttr, EthtoolHandle};
use smol::stream::{Stream, StreamExt};

use super::checks::{Finding, text};

/// Everything about the interface. `root` is `/`.
pub(crate) fn look(root: &Path, name: &str) -> Vec<Finding> {
    let directory = root.join("sys/class/net").join(name);
    // This program opens no other directory.
    let is_name = !["", ".", ".."].contains(&name) && !name.contains('/');
    if is_name && !directory.exists() && is_there(root, name) {
        let found = "not shown by /sys, which is of another network namespace";
        let change = "`mount -t sysfs sysfs /sys` in this one, or run it in the namespace of /sys";
        return vec![Finding::change("interface", found, change)];
    }
    if !is_name || !directory.exists() {
        let change = format!("there is no interface `{name}`: `ip link` lists them");
        return vec![Finding::change("interface", "none", change)];
    }
    let mut findings = vec![
        kind(&directory),
        owner(&directory, name),
        longest_frame(&directory, name),
        link(&directory, name),
        speed(&directory, name),
        addresses(root, name),
    ];
    findings.extend(driver(name));
    findings
}

/// Whether this process has an interface of this name.
fn is_there(root: &Path, name: &str) -> bool {
    let devices = text(root, "proc/net/dev").unwrap_or_default();
    let mut names = devices.lines().filter_map(|line| line.split_once(':'));
    names.any(|(there, _)| there.trim() == name)
}

fn kind(directory: &Path) -> Finding {
    let check = "interface";
    if directory.join("wireless").exists() {
        return Finding::change(check, "wireless", "EtherCAT needs a cable");
    }
    // ARPHRD_ETHER of linux/if_arp.h.
    if text(directory, "type").is_some_and(|kind| kind != "1") {
        return Finding::change(check, "not Ethernet", "name an Ethernet interface");
    }
    let uevent = text(directory, "uevent").unwrap_or_default();
    if let Some(kind) = uevent
        .lines()
        .find_map(|line| line.strip_prefix("DEVTYPE="))
        .filter(|kind| ["bridge", "bond", "vlan", "macvlan"].contains(kind))
    {
        return Finding::change(
            check,
            format!("a {kind}"),
            "the system's own work with frames stands between it and the cable: name the interface that the cable is plugged into, \
             and take it out of this one (`ip link set PORT nomaster`)",
        );
    }
    match target(&directory.join("device/driver")) {
        Some(driver) if driver.starts_with("usb") || driver.starts_with("r8152") => {
            Finding::change(
                check,
                driver,
                "a USB adapter answers by the USB's own millisecond frames: use one on PCI Express",
            )
        }
        Some(driver) => Finding::good(check, format!("driver {driver}")),
        None => Finding::unknown(check, "virtual, without a driver"),
    }
}

/// The last part of where a symbolic link of the system leads to.
fn target(link: &Path) -> Option<String> {
    let path = std::fs::read_link(link).ok()?;
    Some(path.file_name()?.to_string_lossy().into_owned())
}

/// What comes in at a port of a bridge or bond is handed to that, and no socket on the port sees it.
fn owner(directory: &Path, name: &str) -> Finding {
    let check = "bridge or bond";
    match target(&directory.join("master")) {
        None => Finding::good(check, "a part of none"),
        Some(owner) => Finding::change(
            check,
            format!("a port of {owner}"),
            format!("{owner} takes the frames that come back: `ip link set {name} nomaster`"),
        ),
    }
}

/// What an Ethernet frame holds behind its header (IEEE 802.3): EtherCAT uses all of it.
const LONGEST_PAYLOAD: u32 = 1500;

fn longest_frame(directory: &Path, name: &str) -> Finding {
    let check = "MTU";
    match text(directory, "mtu").and_then(|mtu| mtu.parse::<u32>().ok()) {
        None => Finding::unknown(check, "not stated by the system"),
        Some(mtu) if mtu >= LONGEST_PAYLOAD => Finding::good(check, format!("{mtu} bytes")),
        Some(mtu) => Finding::change(
            check,
            format!("{mtu} bytes"),
            format!("EtherCAT's frames have up to 1500: `ip link set {name} mtu 1500`"),
        ),
    }
}

fn link(directory: &Path, name: &str) -> Finding {
    let check = "link";
    // Reading the carrier of an interface that is down is an error.
    match text(directory, "carrier").as_deref() {
        Some("1") => Finding::good(check, "up, with a carrier"),
        Some(_) => Finding::change(
            check,
            "no carrier",
            "plug the cable in, and switch the first device on",
        ),
        None => Finding::change(check, "down", format!("`ip link set {name} up`")),
    }
}

fn speed(directory: &Path, name: &str) -> Finding {
    let check = "speed";
    let speed = text(directory, "speed").unwrap_or_default();
    let duplex = text(directory, "duplex").unwrap_or_default();
    match (speed.as_str(), duplex.as_str()) {
        ("" | "-1", _) => Finding::unknown(check, "not stated by the system"),
        ("100", "full") => Finding::good(check, "100 Mbit/s, full duplex"),
        _ => Finding::change(
            check,
            format!("{speed} Mbit/s, {duplex} duplex"),
            format!(
                "EtherCAT runs at 100 Mbit/s, full duplex: is an EtherCAT device plugged into {name}?"
            ),
        ),
    }
}

/// Other programs use an interface that has addresses or routes.
fn addresses(root: &Path, name: &str) -> Finding {
    let check = "other traffic";
    let routes = text(root, "proc/net/route").unwrap_or_default();
    let ipv6 = text(root, "proc/net/if_inet6").unwrap_or_default();
    let first = |line: &&str| line.split_whitespace().next() == Some(name);
    let last = |line: &&str| line.split_whitespace().last() == Some(name);
    match (
        routes.lines().any(|line| first(&line)),
        ipv6.lines().any(|line| last(&line)),
    ) {
        (false, false) => Finding::good(check, "no addresses, no routes"),
        (routes, _) => Finding::change(
            check,
            if routes {
                "IP routes"
            } else {
                "an IPv6 address"
            },
            format!(
                "the system sends frames of its own among EtherCAT's: `ip addr flush dev {name}`, `sysctl -w \
                 net.ipv6.conf.{name}.disable_ipv6=1`, and leave it out of the network manager \
                 (`nmcli device set {name} managed no`)"
            ),
        ),
    }
}

/// What the driver says over the kernel's ethtool interface.
fn driver(name: &str) -> Vec<Finding> {
    let (offloads, coalescing) = ("offloads", "coalescing");
    let asked = || -> Result<_, Box<dyn std::error::Error>> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_io()
            .build()?;
        Ok(runtime.block_on(ask(name))?)
    };
    let answer = match asked() {
        Ok(answer) => answer,
        Err(error) => return vec![Finding::unknown(offloads, error.to_string())],
    };
    vec![
        answer.active.map_or_else(
            || Finding::unknown(offloads, "the driver does not say"),
            |active| told_of_offloads(name, &active),
        ),
        answer.delay.map_or_else(
            || Finding::unknown(coalescing, "the driver does not say"),
            |delay| told_of_coalescing(name, &delay),
        ),
    ]
}

/// Offloads that hold received frames back until more have come, by the names of the kernel.
const HOLDING: [&str; 3] = ["rx-gro", "rx-lro", "rx-gro-hw"];

fn told_of_offloads(name: &str, active: &[String]) -> Finding {
    let check = "offloads";
    let held: Vec<_> = HOLDING
        .into_iter()
        .filter(|holding| active.iter().any(|on| on == holding))
        .collect();
    if held.is_empty() {
        return Finding::good(check, "received frames are handed on one by one");
    }
    let off: Vec<_> = held
        .iter()
        .map(|feature| format!("{feature} off"))
        .collect();
    Finding::change(
        check,
        held.join(", "),
        format!("`ethtool -K {name} {}`", off.join(" ")),
    )
}

/// What a driver waits for before it reports a frame: each setting that it has, by ethtool's name, with its value.
type Delay = Vec<(&'static str, u32)>;

fn told_of_coalescing(name: &str, delay: &Delay) -> Finding {
    let check = "coalescing";
    let on: Vec<_> = delay.iter().filter(|(_, value)| *value != 0).collect();
    if on.is_empty() {
        return Finding::good(check, "an interrupt for each frame");
    }
    let is_switch = |setting: &str| setting.starts_with("adaptive");
    let found: Vec<_> = on
        .iter()
        .map(|(setting, value)| {
            if is_switch(setting) {
                (*setting).to_owned()
            } else {
                format!("{setting} {value} µs")
            }
        })
        .collect();
    // A driver refuses all of a command in which there is one setting that it does not have.
    let off: Vec<_> = on
        .iter()
        .map(|(setting, _)| format!("{setting} {}", if is_switch(setting) { "off" } else { "0" }))
        .collect();
    Finding::change(
        check,
        found.join(", "),
        format!("`ethtool -C {name} {}`", off.join(" ")),
    )
}

/// What a driver answers; none where it does not.
#[derive(Debug, Default)]
struct Answer {
    active: Option<Vec<String>>,
    delay: Option<Delay>,
}

async fn ask(name: &str) -> std::io::Result<Answer> {
    let (connection, mut handle, _) = ethtool::new_connection()?;
    tokio::spawn(connection);
    let mut answer = Answer::default();
    for attribute in features(&mut handle, name).await {
        if let EthtoolAttr::Feature(EthtoolFeatureAttr::Active(bits)) = attribute {
            let on = bits.into_iter().filter(|bit| bit.value).map(|bit| bit.name);
            answer.active = Some(on.collect());
        }
    }
    for attribute in coalescing(&mut handle, name).await {
        let EthtoolAttr::Coalesce(attribute) = attribute else {
            continue;
        };
        let delay = answer.delay.get_or_insert_default();
        match attribute {
            EthtoolCoalesceAttr::UseAdaptiveRx(on) => delay.push(("adaptive-rx", on.into())),
            EthtoolCoalesceAttr::UseAdaptiveTx(on) => delay.push(("adaptive-tx", on.into())),
            EthtoolCoalesceAttr::RxUsecs(time) => delay.push(("rx-usecs", time)),
            EthtoolCoalesceAttr::TxUsecs(time) => delay.push(("tx-usecs", time)),
            _ => {}
        }
    }
    Ok(answer)
}

async fn features(handle: &mut EthtoolHandle, name: &str) -> Vec<EthtoolAttr> {
    match handle.feature().get(Some(name)).execute().await {
        Ok(messages) => attributes(messages).await,
        Err(_) => Vec::new(),
    }
}

async fn coalescing(handle: &mut EthtoolHandle, name: &str) -> Vec<EthtoolAttr> {
    match handle.coalesce().get(Some(name)).execute().await {
        Ok(messages) => attributes(messages).await,
        Err(_) => Vec::new(),
    }
}

/// A driver that does not support a question answers with an error, which is no answer.
async fn attributes(
    messages: impl Stream<
        Item = Result<netlink_packet_generic::GenlMessage<ethtool::EthtoolMessage>, EthtoolError>,
    >,
) -> Vec<EthtoolAttr> {
    let mut messages = std::pin::pin!(messages);
    let mut all = Vec::new();
    while let Some(Ok(message)) = messages.next().await {
        all.extend(message.payload.nlas);
    }
    all
}

#[cfg(test)]
mod tests {
    use std::{fs, os::unix::fs::symlink, path::Path};

    use super::{kind, longest_frame, look, owner, told_of_coalescing};
    use crate::doctor::checks::Verdict;

    fn interface(files: &[(&str, &str)]) -> tempfile::TempDir {
        let directory = tempfile::tempdir().unwrap();
        for (file, text) in files {
            fs::write(directory.path().join(file), text).unwrap();
        }
        directory
    }

    #[test]
    fn what_is_no_name_of_an_interface_is_none() {
        for name in ["", ".", "..", "../net", "no-such-if0"] {
            let found = look(Path::new("/"), name);
            assert_eq!(found.len(), 1, "{name}");
            assert_eq!(found[0].found, "none");
        }
    }

    #[test]
    fn an_interface_that_only_sys_does_not_show_is_not_told_to_be_missing() {
        let root = tempfile::tempdir().unwrap();
        fs::create_dir_all(root.path().join("proc/net")).unwrap();
        let devices = "Inter-| Receive\n face |bytes\n    lo: 0 0\n  plc0: 0 0\n";
        fs::write(root.path().join("proc/net/dev"), devices).unwrap();
        let [found] = &look(root.path(), "plc0")[..] else {
            panic!("one finding");
        };
        assert!(found.found.contains("another network namespace"));
        assert_eq!(look(root.path(), "plc1")[0].found, "none");
    }

    #[test]
    fn a_bridge_its_port_and_what_is_no_ethernet_are_told() {
        let bridge = interface(&[
            ("type", "1\n"),
            ("uevent", "DEVTYPE=bridge\nINTERFACE=br0\n"),
        ]);
        assert_eq!(kind(bridge.path()).found, "a bridge");
        let loopback = interface(&[("type", "772\n"), ("uevent", "INTERFACE=lo\n")]);
        assert_eq!(kind(loopback.path()).found, "not Ethernet");
        let port = interface(&[("type", "1\n"), ("uevent", "INTERFACE=eth0\n")]);
        assert_eq!(owner(port.path(), "eth0").verdict, Verdict::Good);
        symlink("../br0", port.path().join("master")).unwrap();
        let found = owner(port.path(), "eth0");
        assert_eq!(found.found, "a port of br0");
        assert!(
            found
                .change
                .unwrap()
                .contains("`ip link set eth0 nomaster`")
        );
    }

    #[test]
    fn an_interface_of_short_frames_is_told() {
        let short = interface(&[("mtu", "1400\n")]);
        assert_eq!(longest_frame(short.path(), "eth0").verdict, Verdict::Change);
        let usual = interface(&[("mtu", "1500\n")]);
        assert_eq!(longest_frame(usual.path(), "eth0").verdict, Verdict::Good);
    }

    #[test]
    fn of_coalescing_only_what_the_driver_has_is_to_be_changed() {
        let found = told_of_coalescing("eth0", &vec![("rx-usecs", 3), ("tx-usecs", 0)]);
        assert_eq!(found.found, "rx-usecs 3 µs");
        assert_eq!(
            found.change.as_deref(),
            Some("`ethtool -C eth0 rx-usecs 0`")
        );
        let found = told_of_coalescing("eth0", &vec![("adaptive-rx", 1), ("rx-usecs", 50)]);
        assert_eq!(
            found.change.as_deref(),
            Some("`ethtool -C eth0 adaptive-rx off rx-usecs 0`")
        );
        assert_eq!(
            told_of_coalescing("eth0", &vec![("rx-usecs", 0)]).verdict,
            Verdict::Good
        );
    }
}
