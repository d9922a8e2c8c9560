//! A test authority and its certificates.

use anyhow::{Context as _, Result, ensure};
use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa,
    Issuer, KeyPair, KeyUsagePurpose,
};
use std::{fmt, path::Path};
use time::{Duration, OffsetDateTime};
use x509_parser::pem::parse_x509_pem;

/// The authority's certificate, in its folder.
pub(super) const CERTIFICATE: &str = "authority.pem";
/// The authority's key.
pub(super) const KEY: &str = "authority.key";

/// Clocks of robots may be this much behind.
const TOLERANCE: Duration = Duration::days(1);

/// An authority outlives its certificates, so that it can sign new ones.
const AUTHORITY_DAYS: i64 = 3650;

/// From when to when a certificate is valid.
pub(super) struct Validity {
    from: OffsetDateTime,
    to: OffsetDateTime,
    days: i64,
}

impl Validity {
    /// From now on, for `days`.
    ///
    /// # Errors
    /// The end is later than certificates can hold.
    pub(super) fn days(days: u16) -> Result<Self> {
        let (now, days) = (OffsetDateTime::now_utc(), i64::from(days));
        let later = |days| now.checked_add(Duration::days(days));
        let to = later(days).context("the certificates would end later than any date")?;
        Ok(Self {
            from: now.saturating_sub(TOLERANCE),
            to,
            days,
        })
    }
}

impl fmt::Display for Validity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let date = self.to.date();
        write!(
            f,
            "{:04}-{:02}-{:02}",
            date.year(),
            u8::from(date.month()),
            date.day()
        )
    }
}

/// The owner of a certificate.
#[derive(Clone, Copy)]
pub(super) enum Purpose<'a> {
    /// The router, under these names.
    Router(&'a [String]),
    /// A session, which cannot pass for the router.
    Session,
}

/// A certificate with its key, both as PEM.
pub(super) struct Certified {
    pub(super) certificate: String,
    pub(super) key: String,
}

/// An authority that signs.
pub(super) struct Authority {
    pem: String,
    key: String,
    issuer: Issuer<'static, KeyPair>,
}

impl Authority {
    /// A new one, with a name of its own.
    pub(super) fn new(validity: &Validity) -> Result<Self> {
        let now = OffsetDateTime::now_utc().unix_timestamp_nanos();
        let mut params = params(&format!("wm keys {now}"));
        params.not_before = validity.from;
        params.not_after = validity
            .from
            .checked_add(Duration::days(validity.days.max(AUTHORITY_DAYS) + 2))
            .context("the authority would end later than any date")?;
        let pair = KeyPair::generate()?;
        Ok(Self {
            pem: params.self_signed(&pair)?.pem(),
            key: pair.serialize_pem(),
            issuer: Issuer::new(params, pair),
        })
    }

    /// The one of an earlier `wm keys` in this folder.
    ///
    /// # Errors
    /// A file is missing or malformed, or they do not belong together.
    pub(super) fn open(folder: &Path) -> Result<Self> {
        let read = |file| {
            let path = folder.join(file);
            std::fs::read_to_string(&path).with_context(|| path.display().to_string())
        };
        Self::from_pem(read(CERTIFICATE)?, read(KEY)?)
            .with_context(|| format!("the authority in {}", folder.display()))
    }

    fn from_pem(pem: String, key: String) -> Result<Self> {
        let pair = KeyPair::from_pem(&key).context("its key")?;
        let (_, contents) = parse_x509_pem(pem.as_bytes()).context("its certificate")?;
        let certificate = contents.parse_x509().context("its certificate")?;
        let public = &certificate.public_key().subject_public_key.data;
        ensure!(
            **public == *pair.public_key_raw(),
            "expected the key of its certificate, got another"
        );
        let name = certificate.subject().iter_common_name().next();
        let name = name.and_then(|name| name.as_str().ok());
        let issuer = Issuer::new(params(name.context("its certificate has no name")?), pair);
        Ok(Self { pem, key, issuer })
    }

    /// Its certificate.
    pub(super) fn pem(&self) -> &str {
        &self.pem
    }

    /// Its key.
    pub(super) fn key(&self) -> &str {
        &self.key
    }

    /// Issues a certificate with a new key.
    pub(super) fn issue(
        &self,
        name: &str,
        purpose: Purpose<'_>,
        validity: &Validity,
    ) -> Result<Certified> {
        let (hosts, usage) = match purpose {
            Purpose::Router(hosts) => (hosts, ExtendedKeyUsagePurpose::ServerAuth),
            Purpose::Session => (&[][..], ExtendedKeyUsagePurpose::ClientAuth),
        };
        let mut params = CertificateParams::new(hosts)
            .with_context(|| format!("the names of the router: {}", hosts.join(", ")))?;
        set_name(&mut params, name);
        params.is_ca = IsCa::ExplicitNoCa;
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.extended_key_usages = vec![usage];
        params.use_authority_key_identifier_extension = true;
        params.not_before = validity.from;
        params.not_after = validity.to;
        let key = KeyPair::generate()?;
        let certificate = params.signed_by(&key, &self.issuer);
        Ok(Certified {
            certificate: certificate.with_context(|| name.to_owned())?.pem(),
            key: key.serialize_pem(),
        })
    }
}

/// An authority of this name.
fn params(name: &str) -> CertificateParams {
    let mut params = CertificateParams::default();
    set_name(&mut params, name);
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    params
}

fn set_name(params: &mut CertificateParams, name: &str) {
    params.distinguished_name = DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, name);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn authority_is_read_again_and_foreign_keys_are_refused() {
        let validity = Validity::days(1).unwrap();
        let folders = [(); 2].map(|()| tempfile::tempdir().unwrap());
        let authorities = folders.iter().map(|folder| {
            let authority = Authority::new(&validity).unwrap();
            std::fs::write(folder.path().join(CERTIFICATE), authority.pem()).unwrap();
            std::fs::write(folder.path().join(KEY), authority.key()).unwrap();
            authority
        });
        let authorities: Vec<_> = authorities.collect();
        let again = Authority::open(folders[0].path()).unwrap();
        assert_eq!(again.pem(), authorities[0].pem());
        again
            .issue("/wm/encoder", Purpose::Session, &validity)
            .unwrap();

        std::fs::write(folders[0].path().join(KEY), authorities[1].key()).unwrap();
        let error = Authority::open(folders[0].path()).err().unwrap();
        assert!(format!("{error:#}").contains("got another"), "{error:#}");
        std::fs::remove_file(folders[0].path().join(KEY)).unwrap();
        let error = Authority::open(folders[0].path()).err().unwrap();
        assert!(format!("{error:#}").contains(KEY), "{error:#}");
    }

    #[test]
    fn longest_validity_has_a_date() {
        let validity = Validity::days(36500).unwrap();
        assert!(validity.to_string().starts_with("21"), "{validity}");
        Authority::new(&validity).unwrap();
    }
}
