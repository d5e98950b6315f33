// A page that is watched (`clothbench report --watch`) asks a small script beside it which state is the newest, and
// loads itself anew when that is another: a script may be had from a file that was opened from disk, data may not.
// When watching has ended the script is gone, and the page is loaded for the last time, without this. A copy of a
// watched page that was taken elsewhere has never had a script beside it: it is loaded once more, and then left alone.
(() => {
  const note = document.querySelector("[data-watched]"), alone = `clothbench-alone ${location.pathname}`;
  function ask() {
    const script = document.createElement("script");
    script.onload = () => {
      script.remove();
      sessionStorage.removeItem(alone);
      if (self.clothbenchState === note.dataset.watched) setTimeout(ask, 1000);
      else location.reload();
    };
    script.onerror = () => {
      if (sessionStorage.getItem(alone) === note.dataset.watched) return note.remove();
      sessionStorage.setItem(alone, note.dataset.watched);
      location.reload();
    };
    script.src = `${note.dataset.beside}?${Date.now()}`;
    document.head.append(script);
  }
  setTimeout(ask, 1000);
})();
