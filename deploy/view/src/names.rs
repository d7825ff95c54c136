//! The names of the page's server: under which it answers, which pages may read it, and what it prints.
//!
//! A website can make a browser send requests to this PC under a name of its own that resolves to this PC (DNS rebinding). So the
//! server answers only under names that no website can have: its addresses, `localhost`, the PC's own name, and what `--name` adds.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};

use axum::http::StatusCode;
use skein_cluster::host::probe::is_from_elsewhere;
use skein_common::printable::printable;

/// Names of the page's server besides its own.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct NameArgs {
    /// Let the page's server answer under this name too: one of the DNS, or that of a reverse proxy. Can be given several times. The
    /// PC's own name, also with .local, and its addresses need no option
    #[arg(long = "name", value_name = "NAME", value_parser = name)]
    pub names: Vec<String>,
}

/// Largest number of characters of a foreign name in an answer.
const SHOWN: usize = 80;

/// Parses `--name`: a name or an address, without scheme, port and path.
fn name(text: &str) -> Result<String, String> {
    let is_name = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_' | b'.');
    let is_address = unbracketed(text).parse::<IpAddr>().is_ok();
    if is_address || !text.is_empty() && text.len() <= 253 && text.bytes().all(is_name) {
        return Ok(normal(text));
    }
    Err("give a name alone, without scheme, port and path, such as swarm.example.com".to_owned())
}

/// The names of a server.
#[derive(Debug)]
pub(super) struct Names {
    /// This PC's own names, which no website can have.
    own: Vec<String>,
    /// Those of `--name`.
    given: Vec<String>,
    /// The server listens at every address of this PC.
    is_everywhere: bool,
}

impl Names {
    /// The names of a server that listens at this address, with those of `--name`.
    pub(super) fn new(listen: SocketAddr, given: &NameArgs) -> Self {
        let host = hostname::get().ok().and_then(|name| name.into_string().ok());
        Self::of_host(listen, given, host.as_deref())
    }

    fn of_host(listen: SocketAddr, NameArgs { names }: &NameArgs, host: Option<&str>) -> Self {
        let mut own = vec!["localhost".to_owned()];
        own.extend([IpAddr::V4(Ipv4Addr::LOCALHOST), IpAddr::V6(Ipv6Addr::LOCALHOST)].map(|ip| ip.to_string()));
        if !listen.ip().is_unspecified() {
            own.push(listen.ip().to_string());
        }
        if let Some(host) = host.map(normal).filter(|host| !host.is_empty()) {
            let short = host.split('.').next().unwrap_or_default().to_owned();
            own.extend([format!("{short}.local"), short, host]);
        }
        Self { own, given: names.clone(), is_everywhere: listen.ip().is_unspecified() }
    }

    /// Whether a request under this name, the header `Host`, is meant for this server. Behind an address for all networks any
    /// address is, but no name: a foreign website can choose a name, not an address.
    fn is_own(&self, host: &str) -> bool {
        let name = normal(split(host).0);
        self.own.contains(&name) || self.given.contains(&name) || (self.is_everywhere && name.parse::<IpAddr>().is_ok())
    }

    /// Whether a page from this origin, the header `Origin`, is this server's own: it has the request's own name and port, behind
    /// a proxy perhaps another scheme, or a name of `--name`.
    fn may_read(&self, origin: &str, host: &str) -> bool {
        let Some((scheme, authority)) = origin.split_once("://") else { return false };
        let default = match () {
            () if scheme.eq_ignore_ascii_case("http") => 80,
            () if scheme.eq_ignore_ascii_case("https") => 443,
            () => return false,
        };
        let ((name, port), (own, own_port)) = (split(authority), split(host));
        let is_same = normal(name) == normal(own) && port.unwrap_or(default) == own_port.unwrap_or(default);
        is_same || self.given.contains(&normal(name))
    }

    /// Checks the headers `Host` and `Origin` of a request.
    ///
    /// # Errors
    /// If the request is not meant for this server, or comes from a page of another one: the status and a sentence with the option
    /// that allows it.
    pub(super) fn check(&self, host: &str, origin: Option<&str>) -> Result<(), (StatusCode, String)> {
        if !self.is_own(host) {
            let (shown, wanted) = asked(host);
            let why = format!(
                "{shown} is not a name of this server: open it by an address of its PC, or start it with --name {wanted}\n"
            );
            return Err((StatusCode::MISDIRECTED_REQUEST, why));
        }
        match origin {
            Some(origin) if !self.may_read(origin, host) => {
                let (shown, wanted) = asked(origin.split_once("://").map_or(origin, |(_, authority)| authority));
                let why = format!(
                    "a page of {shown} may not read this server: if it is this server's own page behind a proxy, start the server with \
                     --name {wanted}\n"
                );
                Err((StatusCode::FORBIDDEN, why))
            }
            _ => Ok(()),
        }
    }
}

/// A foreign name as an answer shows it, and as the value of `--name`.
fn asked(host: &str) -> (String, String) {
    let wanted = name(split(host).0).unwrap_or_else(|_| "NAME".to_owned());
    let shown = if host.is_empty() { "an empty name".to_owned() } else { printable(host, SHOWN) };
    (shown, wanted)
}

/// A name without the brackets of an IPv6 address.
fn unbracketed(name: &str) -> &str {
    name.strip_prefix('[').and_then(|name| name.strip_suffix(']')).unwrap_or(name)
}

/// A name as names are compared: in lower case, without the dot of a complete name, addresses in one spelling.
fn normal(name: &str) -> String {
    let name = unbracketed(name);
    match name.parse::<IpAddr>() {
        Ok(ip) => ip.to_string(),
        Err(_) => name.strip_suffix('.').unwrap_or(name).to_ascii_lowercase(),
    }
}

/// Name and port of `NAME[:PORT]`.
fn split(host: &str) -> (&str, Option<u16>) {
    match host.rsplit_once(':') {
        Some((name, port)) if !port.contains(']') && !name.is_empty() => match port.parse() {
            Ok(port) => (name, Some(port)),
            Err(_) if port.is_empty() => (name, None),
            Err(_) => (host, None),
        },
        _ => (host, None),
    }
}

/// The addresses to open a page at whose server listens at this one, the most useful first: of a server at every address of the PC
/// those of its networks, and that of the loopback last.
pub(super) fn addresses(listen: SocketAddr) -> Vec<SocketAddr> {
    let found = if_addrs::get_if_addrs().unwrap_or_default();
    reachable(listen, found.into_iter().map(|interface| (interface.name.clone(), interface.ip())))
}

fn reachable(listen: SocketAddr, interfaces: impl Iterator<Item = (String, IpAddr)>) -> Vec<SocketAddr> {
    if !listen.ip().is_unspecified() {
        return vec![listen];
    }
    let fits = |ip: &IpAddr| listen.is_ipv6() || ip.is_ipv4();
    let reachable = interfaces.filter(|(_, ip)| fits(ip) && is_from_elsewhere(ip));
    let mut all: Vec<(String, IpAddr)> = reachable.collect();
    all.sort_by_key(|(name, ip)| (is_virtual(name), ip.is_ipv6()));
    let mut all: Vec<IpAddr> = all.into_iter().map(|(_, ip)| ip).collect();
    all.push(Ipv4Addr::LOCALHOST.into());
    all.dedup();
    all.into_iter().map(|ip| SocketAddr::new(ip, listen.port())).collect()
}

/// Whether an interface of this name leads to virtual machines and containers of this PC, and hardly to a phone.
fn is_virtual(name: &str) -> bool {
    ["docker", "br-", "veth", "virbr", "vmnet", "vboxnet", "vEthernet"].iter().any(|prefix| name.starts_with(prefix))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(listen: &str, given: &[&str]) -> Names {
        let names = given.iter().map(|text| name(text).unwrap()).collect();
        Names::of_host(listen.parse().unwrap(), &NameArgs { names }, Some("Lab-PC.example.org"))
    }

    #[test]
    fn the_own_names_and_addresses_are_accepted_in_every_spelling() {
        let loopback = names("127.0.0.1:7480", &[]);
        for host in [
            "localhost:7480",
            "LOCALHOST:7480",
            "localhost.",
            "127.0.0.1",
            "[::1]:7480",
            "[0:0:0:0:0:0:0:1]:7480",
            "lab-pc:7480",
            "LAB-PC.LOCAL.",
            "lab-pc.example.org:80",
            "lab-pc.local:",
        ] {
            assert!(loopback.check(host, None).is_ok(), "{host}");
        }
        for host in [
            "",
            ":7480",
            "attacker.example",
            "192.168.1.20:7480",
            "lab-pc.example.com",
            "localhost.attacker.example",
            "local",
        ] {
            let (status, text) = loopback.check(host, None).unwrap_err();
            assert!(status == StatusCode::MISDIRECTED_REQUEST && text.contains("--name "), "{host}: {text}");
        }
        let (_, text) = loopback.check("Swarm.Example.com:8443", None).unwrap_err();
        let expected = "Swarm.Example.com:8443 is not a name of this server: open it by an address of its PC, or start it with --name \
                        swarm.example.com\n";
        assert_eq!(text, expected);
        assert!(loopback.check("evil\u{1b}[2J", None).unwrap_err().1.contains("--name NAME"));
        let everywhere = names("0.0.0.0:7480", &[]);
        for host in ["192.168.1.20:7480", "10.0.0.7", "[fd00::7]:7480", "lab-pc.local:7480", "localhost:7480"] {
            assert!(everywhere.check(host, None).is_ok(), "{host}");
        }
        assert!(everywhere.check("attacker.example:7480", None).is_err(), "a website can choose a name");
        let at_one = names("192.168.1.20:7480", &["swarm.example.com"]);
        for host in ["192.168.1.20:7480", "swarm.example.com", "SWARM.example.com.:8443"] {
            assert!(at_one.check(host, None).is_ok(), "{host}");
        }
        assert!(at_one.check("192.168.1.21:7480", None).is_err());
    }

    #[test]
    fn only_own_pages_read_the_server_also_behind_a_proxy() {
        let plain = names("127.0.0.1:7480", &[]);
        let own = [
            ("http://localhost:7480", "localhost:7480"),
            ("http://LOCALHOST:7480", "localhost:7480"),
            ("https://lab-pc.local", "lab-pc.local"),
            ("https://lab-pc.local", "lab-pc.local:443"),
            ("http://lab-pc", "lab-pc:80"),
            ("http://[::1]:7480", "[::1]:7480"),
        ];
        for (origin, host) in own {
            assert!(plain.check(host, Some(origin)).is_ok(), "{origin} {host}");
        }
        let foreign = [
            ("http://attacker.example", "localhost:7480"),
            ("http://localhost:3000", "localhost:7480"),
            ("http://127.0.0.1:7480", "localhost:7480"),
            ("http://localhost", "localhost:7480"),
            ("null", "localhost:7480"),
            ("", "localhost:7480"),
            ("file://", "localhost:7480"),
            ("ftp://localhost:7480", "localhost:7480"),
            ("http://localhost:7480.attacker.example", "localhost:7480"),
            ("https://swarm.example.com", "127.0.0.1:7480"),
        ];
        for (origin, host) in foreign {
            let (status, text) = plain.check(host, Some(origin)).unwrap_err();
            assert!(status == StatusCode::FORBIDDEN && text.contains("--name "), "{origin} {host}: {text}");
        }
        let text = plain.check("127.0.0.1:7480", Some("https://swarm.example.com:8443")).unwrap_err().1;
        assert!(
            text.starts_with("a page of swarm.example.com:8443 may not")
                && text.ends_with("--name swarm.example.com\n"),
            "{text}"
        );
        let behind = names("127.0.0.1:7480", &["Swarm.example.com", "10.0.0.9"]);
        for origin in ["https://swarm.example.com", "http://SWARM.EXAMPLE.COM.:81", "http://10.0.0.9:8000"] {
            assert!(behind.check("127.0.0.1:7480", Some(origin)).is_ok(), "{origin}");
        }
        assert!(behind.check("127.0.0.1:7480", Some("https://other.example.com")).is_err());
    }

    #[test]
    fn a_name_is_a_name_alone() {
        for text in ["https://a.example", "a.example:80", "a/b", "", "a b", "*"] {
            assert!(name(text).unwrap_err().contains("such as swarm.example.com"), "{text}");
        }
        assert_eq!(name("Swarm_1.Example.COM."), Ok("swarm_1.example.com".to_owned()));
        assert_eq!((name("[FD00::1]"), name("fd00::1")), (Ok("fd00::1".to_owned()), Ok("fd00::1".to_owned())));
    }

    #[test]
    fn a_server_at_every_address_prints_those_that_other_pcs_can_use() {
        let found = [
            ("lo", "127.0.0.1"),
            ("lo", "::1"),
            ("docker0", "172.17.0.1"),
            ("eth0", "fe80::1"),
            ("eth0", "fd00::20"),
            ("eth0", "192.168.1.20"),
            ("usb0", "169.254.3.4"),
            ("wlan0", "10.0.0.7"),
        ];
        let at = |listen: &str| {
            let found = found.iter().map(|(name, ip)| ((*name).to_owned(), ip.parse().unwrap()));
            let all = reachable(listen.parse().unwrap(), found);
            all.iter().map(SocketAddr::to_string).collect::<Vec<_>>()
        };
        assert_eq!(at("0.0.0.0:7480"), ["192.168.1.20:7480", "10.0.0.7:7480", "172.17.0.1:7480", "127.0.0.1:7480"]);
        let both = ["192.168.1.20:80", "10.0.0.7:80", "[fd00::20]:80", "172.17.0.1:80", "127.0.0.1:80"];
        assert_eq!(at("[::]:80"), both);
        assert_eq!(at("10.0.0.7:7480"), ["10.0.0.7:7480"]);
    }
}
