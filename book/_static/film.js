// Plays the films of a page, unless the reader asked the system for reduced motion.
document.addEventListener("DOMContentLoaded", () => {
  if (window.matchMedia("(prefers-reduced-motion: reduce)").matches) {
    return;
  }
  for (const film of document.querySelectorAll("video.film")) {
    film.play().catch(() => {}); // a browser may refuse; the controls remain
  }
});
