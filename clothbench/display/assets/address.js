// Choices live in the address, as #section?case=…&metric=…, so that a link shows what its sender saw.
const address = (() => {
  const listeners = new Map();
  const parts = () => location.hash.slice(1).split("?");
  const chosen = () => new URLSearchParams(parts()[1] ?? "");
  function keep(name, value) {
    const all = chosen();
    all.set(name, value);
    history.replaceState(null, "", `#${parts()[0]}?${all}`);
  }
  function listen(name, told) {
    listeners.set(name, [...(listeners.get(name) ?? []), told]);
    if (chosen().has(name)) told(chosen().get(name));
  }
  function tell(name, value) {
    for (const told of listeners.get(name) ?? []) told(value);
  }
  function choose(name, value) {
    keep(name, value);
    tell(name, value);
  }
  function follow() {
    for (const [name, value] of chosen()) tell(name, value);
    const place = document.getElementById(decodeURIComponent(parts()[0]));
    if (place && parts().length > 1) place.scrollIntoView();
  }
  addEventListener("hashchange", follow);
  addEventListener("load", follow);
  return { keep, listen, choose, get: (name) => chosen().get(name) };
})();
